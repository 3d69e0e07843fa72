"""UWB: tags, anchors and ranges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from graphnav._schema import Array, Record, column, param


@dataclass(frozen=True, eq=False)
class UwbTag(Record):
    """A UWB tag on the machine."""

    SECTION: ClassVar[str] = "uwb.tag"
    id: str = param(kind="str")
    lever_arm_b_m: Array = param((0.0, 0.0, 0.0), shape=(3,))


@dataclass(frozen=True, eq=False)
class UwbAnchor(Record):
    """A UWB anchor, surveyed or, in a `group`, known but for a rigid displacement of all anchors of that group.

    `bias_sigma_m` is the sigma of its constant error where that is not the one of all anchors.
    """

    SECTION: ClassVar[str] = "uwb.anchor"
    id: str = param(kind="str")
    pos_n_m: Array = param(shape=(3,))
    sigma_m: float = param(positive=True)
    group: str | None = param(None, kind="str")
    bias_sigma_m: float | None = param(None, positive=True)


@dataclass(frozen=True, eq=False)
class Uwb(Record):
    """UWB ranges with their tags and anchors.

    A range is the distance plus its anchor's constant, a first-order Markov process of its own, and white noise;
    `rest_factor` times the latter two while the machine stands. With `scale_sigma` the distance counts times one plus
    an unknown that all ranges share (estimated where relative poses carry the state, not yet beside an IMU).

    The anchors of a group stand on one body: truly they are where they are declared (each to its own sigma), turned
    together about up, about the mean of their declared positions, and then moved together. Sigma of the turn (None: no
    turn) and of each axis of the move, both drawn anew for every group.
    """

    SECTION: ClassVar[str] = "uwb"
    TABLE: ClassVar[str] = "uwb"
    STRICT: ClassVar[bool] = False
    t_s: Array = column("t_s")
    tag_id: Any = column("tag", kind="str")
    anchor_id: Any = column("anchor", kind="str")
    range_m: Array = column("range_m", positive=True)
    rssi_db: Array | None = column("rssi_db", optional=True)
    sigma_m: float = param(0.1, positive=True)
    bias_sigma_m: float | None = param(None, positive=True)
    markov_sigma_m: float | None = param(None, positive=True)
    markov_time_s: float | None = param(None, positive=True)
    rest_factor: float = param(1.0, positive=True)
    group_sigma_m: float | None = param(None, positive=True)
    group_turn_sigma_deg: float | None = param(None, positive=True)
    scale_sigma: float | None = param(None, positive=True)
    tag: tuple[UwbTag, ...] = param((), items=UwbTag)
    anchor: tuple[UwbAnchor, ...] = param((), items=UwbAnchor)
    time_offset_s: float = param(0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, used, declared in (("tag", self.tag_id, self.tag), ("anchor", self.anchor_id, self.anchor)):
            ids = [item.id for item in declared]
            known = sorted(set(ids))
            if len(known) < len(ids):
                twice = next(name for name in ids if ids.count(name) > 1)
                raise self.error(f'{name} "{twice}" is declared twice', fix=f"keep one of its [[uwb.{name}]] sections")
            wrong = np.flatnonzero(~np.isin(used, known))
            if len(wrong):
                raise self.error(
                    f'unknown {name} "{used[wrong[0]]}", log.toml declares {known}',
                    row=int(wrong[0]),
                    column=name,
                    fix=f"add a [[uwb.{name}]] section for it",
                )
        if (self.markov_sigma_m is None) != (self.markov_time_s is None):
            raise self.error("markov_sigma_m and markov_time_s belong together", fix="declare both, or neither")
        if self.group_sigma_m is None and any(anchor.group is not None for anchor in self.anchor):
            raise self.error("anchors in groups without group_sigma_m", fix="declare how far a group may have moved")

    @property
    def constant_sigma_m(self) -> Array:
        """(A,) sigma of each anchor's constant error; zero where none is declared."""
        own = (self.bias_sigma_m if a.bias_sigma_m is None else a.bias_sigma_m for a in self.anchor)
        return np.array([sigma or 0.0 for sigma in own])
