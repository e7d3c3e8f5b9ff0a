"""The chained digest: what it covers, byte for byte."""

from __future__ import annotations

import struct
from hashlib import sha256

import numpy as np
import pytest

from bus.state import load_state, save_state
from deploy.errors import DeployError
from deploy.recordings.digest import Digest

PRESENCE = np.array([[True, False], [False, False], [True, True]])
DRIVES = np.array([[0.5, -0.25], [0.0, 1.0], [3.0, 4.0]])
PARCELS = np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]])


def test_the_chain_is_what_a_hand_computed_chain_of_sha256_gives() -> None:
    digest = Digest(b"scene")
    digest.tick(0, PRESENCE, DRIVES, PARCELS)
    digest.tick(1, ~PRESENCE, 2 * DRIVES, -PARCELS)
    first = struct.pack("<QB12d", 0, 0b110001, 0.5, -0.25, 0, 1, 3, 4, 1, 2, 3, 4, 5, 6)
    second = struct.pack("<QB12d", 1, 0b001110, 1.0, -0.5, 0, 2, 6, 8, -1, -2, -3, -4, -5, -6)
    expected = sha256(sha256(sha256(b"scene").digest() + first).digest() + second).hexdigest()
    assert digest.hexdigest == expected


def test_the_motion_digest_is_the_same_chain_without_the_scene() -> None:
    one, other = Digest(b"scene"), Digest(b"another")
    assert one.motion_hexdigest == sha256(b"").hexdigest()
    for digest in (one, other):
        digest.tick(0, PRESENCE, DRIVES, PARCELS)
    first = struct.pack("<QB12d", 0, 0b110001, 0.5, -0.25, 0, 1, 3, 4, 1, 2, 3, 4, 5, 6)
    assert one.motion_hexdigest == sha256(sha256(b"").digest() + first).hexdigest()
    assert other.motion_hexdigest == one.motion_hexdigest
    assert other.hexdigest != one.hexdigest


def test_before_the_first_tick_it_is_the_digest_of_the_description() -> None:
    assert Digest(b"scene").hexdigest == sha256(b"scene").hexdigest()


def test_minus_zero_counts_as_zero() -> None:
    plus, minus = Digest(b""), Digest(b"")
    plus.tick(0, PRESENCE, np.zeros((3, 2)), np.zeros((1, 6)))
    minus.tick(0, PRESENCE, -np.zeros((3, 2)), -np.zeros((1, 6)))
    assert plus.hexdigest == minus.hexdigest


@pytest.mark.parametrize("changed", ["tick", "presence", "drives", "parcels"])
def test_the_smallest_change_of_anything_changes_it(changed: str) -> None:
    one, other = Digest(b""), Digest(b"")
    presence, drives, parcels = PRESENCE.copy(), DRIVES.copy(), PARCELS.copy()
    presence[2, 1] ^= changed == "presence"
    if changed == "drives":
        drives[2, 1] = np.nextafter(drives[2, 1], 9.0)
    if changed == "parcels":
        parcels[0, 5] = np.nextafter(parcels[0, 5], 9.0)
    one.tick(0, PRESENCE, DRIVES, PARCELS)
    other.tick(1 if changed == "tick" else 0, presence, drives, parcels)
    assert one.hexdigest != other.hexdigest
    assert one.motion_hexdigest != other.motion_hexdigest


def test_views_and_other_memory_orders_of_the_same_numbers_agree() -> None:
    one, other = Digest(b""), Digest(b"")
    wide = np.zeros((3, 4))
    wide[:, ::2] = DRIVES
    one.tick(0, PRESENCE, DRIVES, PARCELS)
    other.tick(0, np.asfortranarray(PRESENCE), wide[:, ::2], np.asfortranarray(PARCELS))
    assert one.hexdigest == other.hexdigest


def test_a_checkpoint_carries_the_chain_on() -> None:
    whole = Digest(b"scene")
    whole.tick(0, PRESENCE, DRIVES, PARCELS)
    resumed = Digest(b"another")
    load_state(resumed, save_state(whole))
    for digest in (whole, resumed):
        digest.tick(1, PRESENCE, DRIVES, PARCELS)
    assert resumed.hexdigest == whole.hexdigest
    assert resumed.motion_hexdigest == whole.motion_hexdigest


def test_a_nan_drive_is_named_as_a_bug_with_its_tick_and_place() -> None:
    drives = DRIVES.copy()
    drives[2, 1] = np.nan
    with pytest.raises(DeployError, match=r"this is a bug: tick 7: drives\[2, 1\] is NaN"):
        Digest(b"").tick(7, PRESENCE, drives, PARCELS)


def test_a_nan_state_is_named_as_a_bug_with_its_parcel_and_quantity() -> None:
    parcels = np.vstack((PARCELS, PARCELS))
    parcels[1, 2] = np.nan
    with pytest.raises(DeployError, match=r"tick 8: parcels\[1\]\.angle is NaN"):
        Digest(b"").tick(8, PRESENCE, DRIVES, parcels)


def test_infinities_of_both_signs_are_no_nan() -> None:
    digest = Digest(b"")
    digest.tick(0, PRESENCE, np.array([[np.inf, -np.inf]] * 3), PARCELS)
    assert digest.hexdigest != Digest(b"").hexdigest


def test_a_run_without_parcels_has_a_digest() -> None:
    digest = Digest(b"")
    digest.tick(0, PRESENCE, DRIVES, np.zeros((0, 6)))
    tick = struct.pack("<QB6d", 0, 0b110001, *DRIVES.ravel())
    assert digest.hexdigest == sha256(sha256(b"").digest() + tick).hexdigest()
