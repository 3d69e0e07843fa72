"""The methods by name: what ``graphnav smooth --method`` and ``graphnav compare --methods`` take."""

from __future__ import annotations

#: Name -> what it is, in a few words.
METHODS = {
    "batch": "factor graph, all at once",
    "isam2": "factor graph, incremental (iSAM2), then a batch polish",
    "rts": "error-state Kalman filter and one backward pass over the whole log",
    "rts-online": "the same, smoothed at each end of the face over the cycle just cut",
    "ekf": "error-state Kalman filter alone: each keyframe from the past",
    "lidar-ekf": "the INS/LiDAR paper's Kalman filter: support legs and no odometer",
    "uwb": "a position from every epoch of UWB ranges",
    "uwb-vbukf": "the same, smoothed by the IMU/UWB paper's adaptive filter",
    "imu-uwb": "the IMU/UWB paper's Kalman filter: squared ranges and no odometer",
    "imu-uwb-vbukf": "the same, its positions smoothed by the paper's adaptive filter",
    "sins": "inertial navigation alone, aligned where it starts at rest",
    "stereo": "stereo odometry alone: its motions laid one behind the other",
    "vio-kf": "the stereo paper's Kalman filter: inertial navigation less chained stereo odometry",
    "dead-reckoning": "the gyro's attitude and the odometer's distance",
    "dead-reckoning-cpoem": "dead reckoning corrected at closed-path points",
}
GRAPH_METHODS = ("batch", "isam2")
#: What is of no use without detections of legs.
LEG_METHODS = ("lidar-ekf",)
#: What is of no use without UWB ranges.
UWB_METHODS = ("uwb", "uwb-vbukf", "imu-uwb", "imu-uwb-vbukf")
#: What is of no use without motions from a camera, and what they are compared with in the stereo paper.
STEREO_METHODS = ("sins", "stereo", "vio-kf")
#: What looks at a camera's images.
SIGHTED_METHODS = (*GRAPH_METHODS, "stereo", "vio-kf")
