"""Sections of the configuration for what a camera sees: motions, tracked features, how these are found."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from graphnav._config_base import Section


class RelativePoseConfig(Section):
    """Motions of the camera: given as relative poses, or found from its images."""

    use: bool = True
    loss: Literal["none", "huber", "cauchy", "geman-mcclure"] = Field(
        "geman-mcclure", description="how motions that disagree are found; none: all count in full"
    )
    loss_sigmas: float = Field(3.0, gt=0, description="where it departs from least squares")
    reject_sigmas: float = Field(4.0, gt=0, description="motions that are off by more are left out in the end")


class StereoConfig(Section):
    """Features that a stereo camera tracks."""

    form: Literal["tight", "loose", "off"] = Field(
        "tight", description="every feature a point of the graph, or relative poses from them; off: neither"
    )
    loss: Literal["none", "huber", "cauchy", "geman-mcclure"] = Field(
        "geman-mcclure", description="how readings that disagree are found; none: all count in full"
    )
    loss_sigmas: float = Field(3.0, gt=0, description="where it departs from least squares")
    reject_sigmas: float = Field(4.0, gt=0, description="readings that are off by more are left out in the end")


class StereoTracksConfig(Section):
    """Features followed through image pairs, where the log has images and no tracks."""

    features: Literal["orb", "sift"] = "orb"
    enhance: Literal["none", "clahe", "retinex-dust"] = Field("clahe", description="what is done to the images before")
    follow: Literal["flow", "descriptors"] = Field(
        "flow", description="from frame to frame by the image around a feature, or by matching descriptors as the paper"
    )
    subpixel: bool = Field(True, description="places to a fraction of a pixel, by correlation with the first sight")
    max_features: int = Field(300, ge=8, le=5000, description="features followed at a time, spread over the image")
    min_features: int = Field(12, ge=3, description="a frame with fewer is skipped")
    min_depth_m: float = Field(1.0, gt=0, description="nothing is nearer; it bounds the disparities looked at")
    bias_px: float = Field(
        0.005,
        ge=0,
        description="sigma of what all disparities are too large by as features are found, beside the camera's own",
    )
    min_disparity_px: float = Field(0.5, ge=0, description="features farther away than this tells are left out")


class StereoMotionsConfig(Section):
    """Motions of the stereo camera from tracked points."""

    min_inliers: int = Field(20, ge=6, description="fewest points that have to agree on a motion")
    inlier_sigmas: float = Field(4.0, gt=0, description="points that are off by more are taken for wrong matches")
    shared: float = Field(
        0.7, gt=0, lt=1, description="the next keyframe is the last that sees this share of a keyframe's features"
    )
    keyframe_m: float = Field(0.5, gt=0, description="and, where frames are close enough, not much farther away")
    keyframe_deg: float = Field(10.0, gt=0, description="nor turned by much more")
    rotation_prior: Literal["off", "gate", "fuse"] = Field(
        "gate",
        description="what the IMU's rotation is for: rejecting wrong motions, or also improving them (stereo alone;"
        " beside the IMU in a graph it would count twice)",
    )
    rotation_gate_sigmas: float = Field(5.0, gt=0, description="a motion turned farther from it is a failure")
