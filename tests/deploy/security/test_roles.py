"""Roles give leave for what the lockstep does, and for nothing else."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from bus.sensors import SensorSchema
from bus.wire.format import RunSchema
from bus.wire.formats import FORMATS, WireFormat
from bus.wire.frames import COUNTER_LIMIT, TEXT_LIMIT, DriveFrame, LinkFrame, Report, encode_report
from bus.wire.keys import intersects, plant_key, shard_key
from deploy.security.manifest import KeyManifest
from deploy.security.policy import access_control, size_limits
from deploy.security.roles import OPERATOR, PLANT, ProcessLayout, Role, roles_of

MESSAGE = np.dtype([("u", "<f8")])
LATTICE = Lattice((r, c) for r in range(4) for c in range(3) if (r, c) != (1, 1))
CUTS = [(form, shards) for form in FORMATS for shards in (1, 3, len(LATTICE))]


def cut(form: WireFormat, shards: int) -> ProcessLayout:
    names = tuple(f"cells {shard}" for shard in range(shards))
    return ProcessLayout(Partition.even(LATTICE, shards), form, names)


def cells_of(made: ProcessLayout) -> tuple[Role, ...]:
    plant, *cells, operator = roles_of(made)
    assert (plant.name, operator.name) == (PLANT, OPERATOR)
    return tuple(cells)


def covered(keys: set[str], leave: tuple[str, ...]) -> bool:
    return all(any(intersects(key, one) for one in leave) for key in keys)


@pytest.mark.parametrize(("form", "shards"), CUTS)
def test_a_process_may_do_all_that_its_shard_does(form: WireFormat, shards: int) -> None:
    made = cut(form, shards)
    wiring = RunSchema("some-run", made.partition, SensorSchema(1), MESSAGE)
    for shard, role in enumerate(cells_of(made)):
        member = FORMATS[form].participant(wiring, shard)
        own = {shard_key("some-run", shard, leaf) for leaf in ("report", "registers", "snapshot")}
        assert covered({*member.drive_keys, *member.out_keys} | own, role.puts)
        control = plant_key("some-run", "control")
        assert covered({*member.sense_units, *member.in_parts, control}, role.hears)
        assert covered({*member.alive_keys, *member.ready_keys}, role.shows)
        assert covered({plant_key("some-run", "alive")}, role.watches)


@pytest.mark.parametrize(("form", "shards"), CUTS)
def test_no_process_may_put_what_is_another_s_or_the_plant_s(form: WireFormat, shards: int) -> None:
    made = cut(form, shards)
    roles = cells_of(made)
    wiring = RunSchema("some-run", made.partition, SensorSchema(1), MESSAGE)
    of_plant = {*FORMATS[form].coordinator(wiring).sense_keys, plant_key("some-run", "control")}
    of_plant |= {plant_key("some-run", "view"), plant_key("some-run", "alive")}
    for shard, role in enumerate(roles):
        assert role.asks == (shard_key("*", shard, "join"),)
        assert not any(intersects(key, one) for key in of_plant for one in (*role.puts, *role.shows))
    for one, other in combinations(roles, 2):
        assert set(one.puts).isdisjoint(other.puts)
        assert set(one.shows).isdisjoint(other.shows)
        assert not any(key.endswith("/sense") for key in set(one.hears) & set(other.hears))


def test_an_operator_sends_requests_and_reads_and_puts_nothing() -> None:
    operator = roles_of(cut("packed", 2))[-1]
    assert (operator.puts, operator.shows) == ((), ())
    assert operator.asks == ("mdms/*/plant/operator", "mdms/*/plant/view", "mdms/*/plant/status")


@pytest.mark.parametrize(("kind", "field"), [("certificate", "cert_common_names"), ("password", "usernames")])
def test_the_access_control_names_each_role_once_and_denies_the_rest(kind: str, field: str) -> None:
    roles = roles_of(cut("packed", 3))
    access = access_control(roles, kind)
    assert (access["enabled"], access["default_permission"]) == (True, "deny")
    names = [role.name for role in roles if role.name != PLANT]
    assert access["subjects"] == [{"id": name, field: [name]} for name in names]
    rules = {rule["id"]: rule for rule in access["rules"]}
    assert len(rules) == len(access["rules"])
    for role, policy in zip(roles[1:], access["policies"], strict=True):
        own = [rules[name] for name in policy["rules"] if rules[name]["flows"] == ["ingress"]]
        put = [key for rule in own if "put" in rule["messages"] for key in rule["key_exprs"]]
        assert tuple(put) == role.puts
        assert not any("delete" in rule["messages"] for rule in own)


@pytest.mark.parametrize(("form", "shards"), CUTS)
def test_what_a_process_puts_is_within_the_limits_and_little_more_than_it_needs(
    form: WireFormat, shards: int
) -> None:
    made = cut(form, shards)
    large = np.dtype([(f"a_field_of_some_length_{i}", "<f8") for i in range(64)])
    wiring = RunSchema("some-run", made.partition, SensorSchema(1), large)
    manifest = KeyManifest(
        kind="password", scene="a", wire=form, roles={role.name: role.cells for role in roles_of(made)}
    )
    links = max(len(made.partition.outgoing(shard)) for shard in range(shards))
    assert manifest.largest() == (max(map(len, map(made.cells, range(shards)))), links)
    limits = {limit["id"]: limit for limit in size_limits(*manifest.largest(), form)}

    def limit_of(key: str) -> int:
        (found,) = [one for one in limits.values() if any(intersects(key, expr) for expr in one["key_exprs"])]
        return found["size_limit"]

    for shard in range(shards):
        member = FORMATS[form].participant(wiring, shard)
        drive = DriveFrame(2**40, np.full((len(made.cells(shard)), 2), 1e300))
        count = len(made.partition.outgoing(shard))
        links = LinkFrame(2**40, np.ones(count, dtype=bool), np.zeros(count, dtype=large))
        # Of messages that are relayed the limit knows how many there are, and not their type.
        most = max(len(made.partition.outgoing(s)) for s in range(shards)) * 2**13 if member.relays else 0
        for key, payload in zip(member.drive_keys, member.drive_payloads(drive, links), strict=True):
            assert len(payload) <= limit_of(key) <= 4 * len(payload) + 1024 + 16 * len(LATTICE) + most
        for key, payload in zip(member.out_keys, member.link_payloads(links), strict=True):
            assert len(payload) <= limit_of(key)
        names = tuple(("n" * COUNTER_LIMIT, 2**50) for _ in range(COUNTER_LIMIT))
        report = Report("counters", 2**40, made.cells(shard), "ä" * TEXT_LIMIT, (2**50,) * 4, names)
        assert len(encode_report(report)) <= limit_of(shard_key("some-run", shard, "report"))
