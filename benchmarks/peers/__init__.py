"""What a GTSAM user would write for the same problem without graphnav: the benchmarks' peers.

`per_sample` is peer (a), as GTSAM's own examples are written, with a Python odometer factor; `native` is peer (b), the
same with native factors only. Both take the log as graphnav's reader gives it, and keyframes, rest and closed-path
matches from graphnav's front end, which is not counted in their time.
"""
