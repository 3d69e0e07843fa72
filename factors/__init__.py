"""Measurement models of graphnav: one file per sensor, usable alone in anyone's GTSAM graph.

Conventions (this docstring is their sheet)
-------------------------------------------
Frames
    `n` navigation: east-north-up, tangent plane, fixed to the Earth. `b` body (IMU): right-forward-up.
    `m` machine (odometer): right-forward-up. `s` LiDAR: axes as `m`. `c` camera: x right, y down, z forward.
Poses and rotations
    ``R_nb`` rotates b-vectors into n; ``T_nb`` is the pose of b in n. ``R_mb = Exp(alpha)`` takes b-vectors
    to m, alpha being the mounting angles (right, forward, up).
Perturbations
    GTSAM's: right, in the body frame, rotation before translation: ``R Exp(omega)``, ``p + R v``.
Vectors
    a frame suffix on every vector: `pos_n`, `vel_n`, `gyro_b`, `accel_b` (specific force, +g upward at rest).
Units
    SI; datasheet units only where a name carries them (`_deg_h`, `_deg_sqrt_h`, `_mg`, `_mg_sqrt_hz`).
Quaternions
    unit, Hamilton, order w, x, y, z, n <- b.

Every file holds a pure function ``residual(...) -> (error, *jacobians)`` that broadcasts over leading axes, and a
constructor that makes a GTSAM factor of it; where GTSAM has a native factor that fits, the constructor returns
that.
"""
