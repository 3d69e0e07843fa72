"""Compare estimators on one simulated shift, and see how good any could be and what the log can tell at all."""

from __future__ import annotations

import graphnav as gn


def main() -> None:
    log = gn.simulate("shearer-mems", seed=4)

    table = gn.compare(log, methods=["batch", "rts", "ekf", "dead-reckoning"])
    for row in table.rows:
        sep = " / ".join(f"{cycle.sep_m:.3f}" for cycle in row.per_cycle)
        print(f"{row.method:>15}: SEP per cycle {sep} m, {row.seconds:.1f} s")

    limit = gn.bound(log).overall
    print(f"Cramer-Rao bound {limit.bound_3d_m:.3f} m, batch on this log {limit.rms_3d_m:.3f} m (rms in 3-D)")

    known = gn.observe(log)
    for state, ratio, verdict in zip(known.states, known.ratio[-1], known.verdicts, strict=True):
        print(f"{state.name:>32}: {verdict}, sigma by what was known before {ratio:.3g}")
    print("weakest direction:", known.weakest[-1][0].text)


if __name__ == "__main__":
    main()
