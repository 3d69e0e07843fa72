"""The carrier of UWB anchors at the near end of a face, which steps with the face.

The paper mounts its anchors on a body that a motor moves along the roadway before the next pass. In its first place the
carrier is surveyed; from then on it is known by its steps, so its anchors share an unknown displacement and turn.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graphnav.log import UwbAnchor
from graphnav.simulation.ranging import Anchors, Ranger
from graphnav.simulation.uwb_figures import UNDERGROUND, RangingSpec
from graphnav.simulation.world import Streams, World, face_frame

Array = npt.NDArray[np.float64]


def carrier_ranger(world: World, of: Streams, on: float) -> Ranger | None:
    """The tag on the shearer and the anchors on the carrier, if the scenario has UWB."""
    if "uwb" not in world.spec.sensors:
        return None
    carrier_rng, error_rng = of.uwb.spawn(2)
    spec = world.spec.ranging
    return Ranger(spec, carried(world, spec, carrier_rng, on), error_rng, on)


def carried(world: World, spec: RangingSpec, rng: np.random.Generator, on: float) -> Anchors:
    """Anchors in one place for every cutting cycle.

    Place p is the first one and p pushes; truly the carrier stands there turned about up and displaced, with sigmas
    ``group_turn_deg`` and ``group_m`` and anew in every place but the first, and each anchor is off by the survey.
    """
    places, to_n = world.spec.cycles, face_frame(world.spec)
    survey_rng, move_rng, turn_rng = rng.spawn(3)
    first = _first_place(spec)
    later = on * (np.arange(places) > 0)
    moves = later[:, None] * spec.group_m * move_rng.standard_normal((places, 3))
    turns = np.deg2rad(later * spec.group_turn_deg * turn_rng.standard_normal(places))
    declared = first + np.arange(places)[:, None, None] * [world.spec.push_m, 0.0, 0.0]
    surveyed = declared + on * spec.survey_m * survey_rng.standard_normal(declared.shape)
    middle = declared.mean(axis=1)
    rot = Rotation.from_rotvec(turns[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    true = np.einsum("pij,paj->pai", rot, surveyed - middle[:, None]) + (middle + moves)[:, None]
    return Anchors(true @ to_n.T, _sections(declared @ to_n.T, spec.survey_m), _from_s(world))


def _first_place(spec: RangingSpec) -> Array:
    """Anchors about the near end as the paper's are about the end of its way: right, forward, up of the IMU there."""
    x, y, z = np.array(spec.anchors_m).T
    up = z - UNDERGROUND.tag_z_m + spec.lever_arm_b_m[2]
    return np.column_stack([x - UNDERGROUND.tag_x_m, UNDERGROUND.to_y_m - y, up])


def _sections(pos_n: Array, survey_m: float) -> tuple[UwbAnchor, ...]:
    sections = []
    for place, anchors in enumerate(pos_n, start=1):
        step, group = ("", None) if place == 1 else (f".{place}", str(place))
        sections += [UwbAnchor(f"{i}{step}", pos, survey_m, group) for i, pos in enumerate(anchors, start=1)]
    return tuple(sections)


def _from_s(world: World) -> Array:
    """Before each cut but the first the carrier steps, in the middle of the machine's last pause."""
    legs = world.timeline.legs
    steps = [(before.end_s + cut.start_s) / 2 for before, cut in pairwise(legs) if cut.cycle]
    return np.array([-np.inf, *steps])
