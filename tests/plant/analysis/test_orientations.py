"""Orientations against published angles, the plant's own motion, and forces summed over loads found otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from plant import geometry
from plant.analysis.constants import constants_of_motion
from plant.analysis.crossings import crossings
from plant.analysis.equilibrium import continuous_torque, equilibrium_point, linear_field, loaded_moments
from plant.analysis.orientations import Orientation, TorqueProfile
from plant.analysis.static_supports import footprint
from plant.analysis.torque_profile import TorqueProfiler
from plant.errors import PlantError
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.reference import least_norm_loads
from tests.plant.scenes import MU, SECOND, G, elliptic, parcel, spec

LARGE, SMALL, SMALLEST = (10.3, 5.2), (6.3, 2.2), (4.3, 3.1)
FIELD = (-1.0, -0.5)
CENTRE = np.zeros(2)


def _scene(size: tuple[float, float], angle: float = 0.0, pitch: float = 1.0, **values: object) -> PlantSpec:
    """A parcel about the middle cell of an odd array that reaches past it at any angle."""
    count = 2 * int(np.hypot(*size) / 2.0 / pitch + 2.0) + 1
    body = ParcelSpec.model_validate(
        {"size_m": size, "mass_kg": 1.0, "position_m": (0.0, 0.0), "angle_rad": angle} | values
    )
    return spec(body, rows=count, columns=count, pitch_m=pitch)


def _positions(scene: PlantSpec) -> np.ndarray:
    cells = np.array(scene.array.lattice().cells)
    middle = np.array([scene.array.rows - 1, scene.array.columns - 1]) / 2.0
    return (cells - middle)[:, ::-1] * scene.array.pitch_m


def _profile(scene: PlantSpec, speed: np.ndarray | None = None, centre: np.ndarray = CENTRE) -> TorqueProfile:
    speed = _positions(scene) * FIELD if speed is None else speed
    return TorqueProfiler(scene, speed).profile(scene.parcels[0], centre)


def _degrees(found: tuple[Orientation, ...]) -> list[tuple[float, float]]:
    return [(float(np.degrees(one.low_rad)), float(np.degrees(one.high_rad))) for one in found]


# --- the published angles ---------------------------------------------------------------------------


def test_the_large_parcel_is_stable_at_its_published_angles_and_intervals() -> None:
    stable = _profile(_scene(LARGE)).stable()
    switching = _degrees(tuple(one for one in stable if not one.is_interval))
    assert switching == [pytest.approx((at, at), abs=0.005) for at in (84.46, 95.54, 264.46, 275.54)]
    assert _degrees(tuple(one for one in stable if one.is_interval)) == [
        pytest.approx((175.19, 184.81), abs=0.005),
        pytest.approx((355.19, 364.81), abs=0.005),
    ]


def test_the_small_parcel_is_stable_only_in_its_published_intervals() -> None:
    assert _degrees(_profile(_scene(SMALL)).stable()) == [
        pytest.approx((88.08, 91.92), abs=0.005),
        pytest.approx((268.08, 271.92), abs=0.005),
    ]


def test_the_smallest_parcel_has_plateaus_of_no_torque_and_no_angle_where_it_switches() -> None:
    found = _profile(_scene(SMALLEST)).orientations()
    assert len(found) == 12
    assert all(one.is_interval for one in found)


def test_between_two_orientations_that_attract_lies_one_that_does_not() -> None:
    natures = [one.nature for one in _profile(_scene(LARGE)).orientations()]
    assert natures == ["repelling", "attracting"] * 6


def test_the_large_parcel_changes_supports_at_176_angles_a_turn_each_with_a_cell_on_an_edge() -> None:
    scene = _scene(LARGE)
    profile = _profile(scene)
    assert len(profile.angles_rad) == 176
    normal, reach = geometry.edges(footprint(scene.parcels[0]))
    for angle in profile.angles_rad:
        c, s = np.cos(angle), np.sin(angle)
        depth = reach - _positions(scene) @ np.array([[c, -s], [s, c]]) @ normal.T
        on_edge = (np.abs(depth) < 1e-13).any(axis=1) & (depth > -1e-13).all(axis=1)
        assert on_edge.any()


def test_a_turn_on_the_spot_meets_the_same_176_angles() -> None:
    """On wheels that drive nothing: every change of the support set, merged by angle."""
    scene = _scene(LARGE, 0.05, angular_velocity_rad_s=1.0)
    plant = Plant(scene)
    plant.release_wheels(range(len(plant.array)), "coast")
    drives = np.zeros((len(plant.array), 2))
    _, events = plant.advance(drives, round(2.0 * np.pi * SECOND))
    angles = 0.05 + np.array([event.time_s for event in events])
    assert plant.state[0, 5] == pytest.approx(1.0, abs=1e-12)
    met = np.sort(np.mod(angles[np.diff(angles, prepend=-1.0) > 1e-9], 2.0 * np.pi))
    assert met == pytest.approx(_profile(scene).angles_rad, abs=1e-9)


@pytest.mark.parametrize(
    ("pitch", "published"), [(1.0, 0.0879), (0.5, 0.0257), (0.25, 0.0115), (0.125, 0.0029)]
)
def test_the_torque_tends_to_that_of_the_continuous_field(pitch: float, published: float) -> None:
    scene = _scene(LARGE, pitch=pitch)
    angles = np.radians(np.arange(0.0, 360.0, 0.05))
    length, width = LARGE
    peak = MU * G * (FIELD[1] - FIELD[0]) * (length**2 - width**2) / 24.0
    error = _profile(scene).torque_at(angles) - peak * np.sin(2.0 * angles)
    assert np.sqrt(np.mean(error**2)) / abs(peak) == pytest.approx(published, rel=0.015)


# --- against loads found otherwise ------------------------------------------------------------------


def _random_scene(draw: np.random.Generator) -> tuple[PlantSpec, np.ndarray, np.ndarray]:
    """A polygon with its centre of mass anywhere, on an array with holes, in no particular field, at no cell."""
    corners = int(draw.integers(3, 7))
    turns = np.sort(draw.uniform(0.0, 2.0 * np.pi, corners))
    while np.any(np.diff(turns, append=turns[0] + 2.0 * np.pi) > 0.9 * np.pi):
        turns = np.sort(draw.uniform(0.0, 2.0 * np.pi, corners))
    vertices = np.stack([0.28 * np.cos(turns), 0.2 * np.sin(turns)], axis=1)
    body = parcel(
        vertices_m=tuple((float(x), float(y)) for x, y in vertices),
        centre_of_mass_m=tuple(draw.uniform(0.1, 1.0, corners) @ vertices / (0.6 * corners)),
        position_m=(0.0, 0.0),
    )
    holes = [[int(r), int(c)] for r, c in np.unique(draw.integers(0, 9, (12, 2)), axis=0)]
    scene = spec(body, rows=9, columns=9, missing=holes)
    return scene, draw.normal(size=(len(scene.array.lattice()), 2)), draw.uniform(-0.1, 0.1, 2)


def _by_hand(
    scene: PlantSpec, speed: np.ndarray, centre: np.ndarray, angle: float
) -> tuple[float, np.ndarray, int, int]:
    """Torque, force, how many cells carry and how many lie below: eqs. 2, 14 and 15, cell by cell."""
    positions = _positions(scene) - centre
    c, s = np.cos(angle), np.sin(angle)
    normal, reach = geometry.edges(footprint(scene.parcels[0]))
    under = (reach - positions @ np.array([[c, -s], [s, c]]) @ normal.T).min(axis=1) > 0.0
    points, speeds = positions[under], speed[under]
    loads = least_norm_loads(points, np.zeros(2)) if under.any() else None
    if loads is None:
        return np.nan, np.full(2, np.nan), 0, int(under.sum())
    pull = MU * scene.parcels[0].mass_kg * G * loads[:, None] * speeds
    torque = float(np.sum(points[:, 0] * pull[:, 1] - points[:, 1] * pull[:, 0]))
    return torque, pull.sum(axis=0), int(np.sum(loads > 0.0)), int(under.sum())


def test_torque_force_and_supports_are_those_of_least_norm_loads_lifted_cells_and_tipping_included() -> None:
    draw = np.random.default_rng(4)
    lifted = tipped = 0
    for _ in range(60):
        scene, speed, centre = _random_scene(draw)
        try:
            profile = _profile(scene, speed, centre)
        except PlantError:
            profile = None
        for angle in draw.uniform(0.0, 2.0 * np.pi, 12):
            torque, force, carrying, below = _by_hand(scene, speed, centre, float(angle))
            lifted += 0 < carrying < below
            tipped += carrying == 0
            if profile is None:
                assert carrying == 0
                continue
            step = int(np.searchsorted(profile.angles_rad, angle)) - 1
            assert profile.torque_n_m[step] == pytest.approx(torque, abs=1e-10, nan_ok=True)
            assert profile.force_n[step] == pytest.approx(force, abs=1e-10, nan_ok=True)
            assert profile.supports[step] == carrying
    assert lifted > 50
    assert tipped > 50


def test_axes_drawn_otherwise_on_the_parcel_turn_the_profile_and_change_nothing_else() -> None:
    """Turned by one of its angles the profile has a change, of many cells, on either side of zero."""
    scene = _scene(LARGE)
    plain = _profile(scene)
    corners = np.array(scene.parcels[0].polygon())
    for turned in (*plain.angles_rad[::20], 1.0):
        c, s = np.cos(turned), np.sin(turned)
        vertices = corners @ np.array([[c, s], [-s, c]])
        other = _profile(_scene(LARGE, size_m=None, vertices_m=[tuple(v) for v in vertices.tolist()]))
        angles = np.mod(plain.angles_rad - turned, 2.0 * np.pi)
        angles[2.0 * np.pi - angles < 1e-9] = 0.0
        order = np.argsort(angles)
        assert other.angles_rad[0] >= 0.0
        assert other.angles_rad == pytest.approx(angles[order], abs=1e-9)
        assert other.torque_n_m == pytest.approx(plain.torque_n_m[order], abs=1e-12)
        assert [one.nature for one in other.stable()] == ["attracting"] * 6


@pytest.mark.parametrize("width", [np.nextafter(0.6, 0.0), 0.6, np.nextafter(0.6, 1.0)])
def test_a_cell_that_an_edge_only_touches_is_no_change(width: float) -> None:
    scene = spec(parcel(size_m=(1.0, width), position_m=(0.0, 0.0)), rows=21, columns=21)
    angles = _profile(scene).angles_rad
    touching = np.abs(np.mod(angles + 0.5 * np.pi, np.pi) - 0.5 * np.pi) < 1e-3
    # the row under the edge changes at 0 and half a turn, all at once; its cell in the middle, at its foot, never
    assert angles[touching] == pytest.approx([0.0, np.pi], abs=1e-12)


def test_a_cell_that_a_corner_only_touches_is_no_change() -> None:
    cell = np.array([[0.5, 0.0]])
    corners = np.array(geometry.rectangle(0.6, 0.8))
    for turned in np.linspace(0.0, 6.0, 50):
        c, s = np.cos(turned), np.sin(turned)
        passed = crossings(cell, *geometry.edges(corners @ np.array([[c, s], [-s, c]])))
        assert len(passed.angles_rad) == 0
        assert not passed.under.any()


# --- fields and parcels that are special ------------------------------------------------------------


def test_in_a_uniform_field_every_angle_is_as_good_as_any() -> None:
    scene = _scene(SMALL)
    found = _profile(scene, np.tile((0.3, 0.1), (len(_positions(scene)), 1))).orientations()
    assert [(one.low_rad, one.high_rad, one.nature) for one in found] == [(0.0, 2.0 * np.pi, "neutral")]


def test_on_wheels_that_stand_still_nothing_turns() -> None:
    scene = _scene(SMALL)
    assert not _profile(scene, np.zeros_like(_positions(scene))).torque_n_m.any()


def test_in_a_vortex_nothing_stops_the_parcel_from_turning() -> None:
    scene = _scene(SMALL)
    profile = _profile(scene, _positions(scene) @ np.array([[0.0, 1.0], [-1.0, 0.0]]))
    assert np.all(profile.torque_n_m > 0.0)
    assert profile.orientations() == ()


def test_a_parcel_on_one_cell_has_one_torque_and_no_changes() -> None:
    scene = _scene((0.4, 0.3))
    profile = _profile(scene, np.ones_like(_positions(scene)))
    assert len(profile.angles_rad) == 0
    assert profile.torque_n_m.tolist() == [0.0]
    assert profile.supports.tolist() == [1]
    assert profile.torque_at(np.array([1.0])).tolist() == [0.0]


def test_a_parcel_that_stands_at_no_angle_is_refused() -> None:
    with pytest.raises(PlantError, match=r"centre of mass at \(0\.5, 0\) m stands at no angle"):
        _profile(_scene((0.4, 0.3)), centre=np.array([0.5, 0.0]))
    with pytest.raises(PlantError, match="stands at no angle"):
        _profile(_scene(LARGE, centre_of_mass_m=(7.0, 2.5)))


def test_an_interval_beside_angles_at_which_the_parcel_tips_has_no_torque_there() -> None:
    # across two cells it stands only while both are below
    scene = _scene((1.6, 0.3))
    found = _profile(scene, np.zeros_like(_positions(scene)), np.array([0.5, 0.0])).orientations()
    assert _degrees(found)[0] == pytest.approx((180.0 - 17.4576, 180.0 + 17.4576), abs=1e-3)
    assert [(one.nature, one.before_n_m, one.after_n_m) for one in found] == [("neutral", None, None)] * 2


@pytest.mark.parametrize(
    ("angle", "away"), [(0.1, 0.0), (0.0, 0.0), (6.2, 0.0), (0.5, 0.3), (5.5, 0.5), (-0.783, 0.5)]
)
def test_an_angle_lies_so_far_from_an_interval_across_zero(angle: float, away: float) -> None:
    interval = Orientation(6.0, 0.2 + 2.0 * np.pi, "attracting", 1.0, -1.0)
    assert interval.away_from(angle) == pytest.approx(away, abs=1e-3)


# --- the continuous surface -------------------------------------------------------------------------


def test_the_continuous_torque_of_a_rectangle_is_the_closed_form() -> None:
    scene = _scene(LARGE)
    field, moments = (
        linear_field(_positions(scene), _positions(scene) * FIELD + 3.0),
        loaded_moments(scene.parcels[0]),
    )
    assert field is not None
    assert moments is not None
    assert field.rate_per_s == pytest.approx(np.diag(FIELD), abs=1e-12)
    assert field.offset_m_s == pytest.approx([3.0, 3.0], abs=1e-12)
    angles = np.linspace(0.0, 7.0, 50)
    expected = (FIELD[1] - FIELD[0]) * (LARGE[0] ** 2 - LARGE[1] ** 2) / 24.0 * np.sin(2.0 * angles)
    assert continuous_torque(angles, field, moments) == pytest.approx(expected, abs=1e-12)


def test_the_continuous_torque_of_any_polygon_and_field_is_what_many_cells_tend_to() -> None:
    body = parcel(
        vertices_m=((-0.5, -0.3), (0.6, -0.2), (0.1, 0.4)),
        centre_of_mass_m=(0.1, 0.0),
        position_m=(0.0, 0.0),
        mass_kg=1.0,
    )
    scene = spec(body, rows=151, columns=151, pitch_m=0.01)
    matrix = np.array([[-1.0, 0.4], [0.3, -2.0]])
    speed = _positions(scene) @ matrix.T
    field, moments = linear_field(_positions(scene), speed), loaded_moments(body)
    assert field is not None
    assert moments is not None
    angles = np.linspace(0.0, 2.0 * np.pi, 500)
    smooth = MU * G * continuous_torque(angles, field, moments)
    error = _profile(scene, speed).torque_at(angles) - smooth
    assert np.sqrt(np.mean(error**2)) < 6e-3 * np.abs(smooth).max()


def test_a_field_that_is_not_linear_and_a_load_that_would_pull_have_no_continuous_torque() -> None:
    positions = _positions(_scene(SMALL))
    assert linear_field(positions, np.sign(positions)) is None
    assert linear_field(positions[:9], positions[:9]) is None  # cells on a line
    assert loaded_moments(parcel(centre_of_mass_m=(0.08, 0.0))) is not None
    assert loaded_moments(parcel(centre_of_mass_m=(0.1, 0.0))) is None


# --- where the centre of mass comes to rest ---------------------------------------------------------


def test_in_a_linear_field_the_centre_of_mass_comes_to_rest_where_the_field_stands_still() -> None:
    scene = spec(parcel())
    drives = (_positions(scene) - [0.13, -0.27]) * (-1.0, -2.0)
    place = equilibrium_point(scene, 0, drives)
    assert place == pytest.approx([0.13, -0.27], abs=1e-14)
    assert _profile(scene, drives, place).largest_force_n() == 0.0


def test_where_the_field_draws_along_one_axis_only_the_other_stays() -> None:
    scene = spec(parcel())
    drives = _positions(scene) * (-1.0, 0.0)
    assert equilibrium_point(scene, 0, drives) == pytest.approx([0.0, 0.5], abs=1e-14)


def test_in_any_other_field_it_is_where_no_force_is_left_on_the_supports_there() -> None:
    scene = spec(parcel())
    drives = 0.05 - _positions(scene) * (1.0 + 4.0 * _positions(scene) ** 2)
    place = equilibrium_point(scene, 0, drives)
    moved = spec(parcel(position_m=tuple(place.tolist())))
    motion = constants_of_motion(moved, 0, drives)
    assert motion.equilibrium_inside
    assert motion.equilibrium_m == pytest.approx(place, abs=1e-12)
    assert linear_field(_positions(scene), drives) is None


@pytest.mark.parametrize("rates", [(1.0, -1.0), (0.0, 0.0)])
def test_a_field_that_drives_away_or_past_has_no_resting_place(rates: tuple[float, float]) -> None:
    scene = spec(parcel())
    with pytest.raises(PlantError, match=r"parcels\[0\]: from its start no point is found"):
        equilibrium_point(scene, 0, _positions(scene) * rates + 0.1)


# --- where parcels do come to rest ------------------------------------------------------------------


@pytest.mark.parametrize("start", [70.0, 110.0])
def test_the_large_parcel_turns_to_the_nearest_switching_angle_and_chatters_out_there(start: float) -> None:
    scene = _scene(LARGE, np.radians(start))
    plant = Plant(scene)
    _, events = plant.advance(plant.array.positions_m * FIELD, 60 * SECOND)
    stable = _profile(scene).stable()
    assert min(one.away_from(plant.state[0, 2]) for one in stable) < 1e-9
    assert "captured" in {event.kind for event in events}
    assert plant.support_changes < 2000


@pytest.mark.parametrize(
    ("size", "rest"),
    [((0.68, 0.42), 0.17925400095), ((0.72, 0.42), 0.149413822985), ((0.4, 0.42), 1.125235075992)],
)
def test_the_angles_at_which_chatter_was_followed_to_rest_crossing_by_crossing_are_attracting(
    size: tuple[float, float], rest: float
) -> None:
    scene = spec(parcel(size_m=size))
    stable = _profile(scene, _positions(scene) * (-1.0, -2.0)).stable()
    # the run ended while its centre of mass was still about 1e-9 m off
    assert min(abs(one.low_rad - rest) for one in stable if not one.is_interval) < 1e-8


def test_within_an_interval_of_no_torque_the_large_parcel_stays_as_it_is() -> None:
    plant = Plant(_scene(LARGE, np.radians(178.0)))
    before = plant.state
    plant.advance(plant.array.positions_m * FIELD, 20 * SECOND)
    assert plant.state == pytest.approx(before, abs=1e-12)


@pytest.mark.parametrize(
    "size", [(0.54, 0.32), (0.54, 0.38), (0.68, 0.42), (0.4, 0.42), (0.72, 0.42), (0.6, 0.5)]
)
def test_parcels_come_to_rest_at_a_stable_orientation_or_where_nothing_turns_them(
    size: tuple[float, float],
) -> None:
    for angle in (0.2, 0.9, 2.0):
        scene = spec(parcel(size_m=size, angle_rad=angle))
        plant = Plant(scene)
        drives = elliptic(plant)
        plant.advance(drives, 60 * SECOND)
        assert plant.status[0].state == "at_rest"
        found = (
            TorqueProfiler(scene, drives)
            .profile(scene.parcels[0], equilibrium_point(scene, 0, drives))
            .orientations()
        )
        rests = [one.away_from(plant.state[0, 2]) for one in found if one.stable or one.is_interval]
        assert min(rests) < 1e-6


def test_polygons_on_arrays_with_holes_come_to_rest_at_attracting_angles() -> None:
    draw = np.random.default_rng(11)
    rested = 0
    for _ in range(100):
        scene, _, _ = _random_scene(draw)
        place, angle = draw.uniform(-0.1, 0.1, 2).tolist(), float(draw.uniform(0.0, 6.28))
        body = scene.parcels[0].model_copy(update={"position_m": tuple(place), "angle_rad": angle})
        scene = scene.model_copy(update={"parcels": (body,)})
        drives = (_positions(scene) - draw.uniform(-0.05, 0.05, 2)) * (-1.0, -2.5)
        try:
            plant = Plant(scene)
        except PlantError:  # it would tip at the start
            continue
        plant.advance(drives, 90 * SECOND)
        if plant.status[0].state == "at_rest":
            rested += 1
            stable = TorqueProfiler(scene, drives).profile(body, equilibrium_point(scene, 0, drives)).stable()
            assert min(one.away_from(plant.state[0, 2]) for one in stable) < 1e-9
    assert rested > 40
