"""The access control of the plant's sessions, as Zenoh reads it.

A folder of keys has one access control for all roles. The session that cells join uses the part of the cells' roles,
the session for listeners and operators uses the operators' part.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

from bus.lockstep.snapshots import CELL_LIMIT
from bus.wire.frames import COUNTER_LIMIT, TEXT_LIMIT
from bus.wire.keys import WireFormat, cell_key, plant_key, shard_key
from deploy.security.roles import OPERATOR, OPERATORS, PLANT, PLANT_AT_ROUTER, Role

if TYPE_CHECKING:
    from bus.transports.zenoh.session import AccessPolicy


_ENVELOPE: Final = 1 << 10
"""Bytes for the common part of every payload: names, tick, version."""
_MESSAGE: Final = 1 << 13
"""Bytes for the message of one link: twice what a firmware may declare, with the names of its fields."""
_REGISTERS: Final = 1 << 14
"""Bytes for the registers of one cell."""
_QUESTION: Final = 1 << 17


def size_limits(cells: int, links: int, wire: WireFormat) -> list[dict[str, Any]]:
    """Return Zenoh's ``low_pass_filter`` of a session that cells join, the plant's or a router's.

    Longer messages are dropped on arrival, and counted as denied.

    Args:
        cells: Most cells of a process.
        links: Most links from the cells of a process to others.
        wire: Wire format.
    """
    relayed = _MESSAGE * links if wire == "relayed" else 0
    report = 4 * TEXT_LIMIT + COUNTER_LIMIT * (4 * COUNTER_LIMIT + 16) + 16 * cells
    link_keys = ["mdms/*/cell/*/*/to/*", "mdms/*/shard/*/to/*"]
    return [
        _limit(
            "drive",
            [cell_key("*", None, "drive"), shard_key("*", None, "drive")],
            _ENVELOPE + 16 * cells + relayed,
        ),
        _limit("link", link_keys, _ENVELOPE + _MESSAGE * max(links, 1)),
        _limit("report", [shard_key("*", None, "report")], _ENVELOPE + report),
        _limit("registers", [shard_key("*", None, "registers")], _ENVELOPE + _REGISTERS * cells),
        _limit("snapshot", [shard_key("*", None, "snapshot")], _ENVELOPE + CELL_LIMIT * (cells + 1)),
    ]


def _limit(name: str, keys: list[str], size: int, message: str = "put") -> dict[str, Any]:
    return {"id": name, "flows": ["ingress"], "messages": [message], "key_exprs": keys, "size_limit": size}


QUESTION_LIMITS: Final = [
    _limit(
        "question",
        [plant_key("*", "operator"), plant_key("*", "status"), shard_key("*", None, "join")],
        _QUESTION,
        "query",
    )
]
"""Zenoh's ``low_pass_filter`` of the session for listeners and operators."""


_SUBJECT: Final = {"certificate": "cert_common_names", "password": "usernames"}
"""Property by which Zenoh identifies a session, by kind of credentials."""
_MESSAGES: Final = {
    "puts": ["put"],
    "hears": ["declare_subscriber"],
    "shows": ["liveliness_token"],
    "watches": ["declare_liveliness_subscriber", "liveliness_query"],
    "asks": ["query"],
    "answers": ["declare_queryable", "reply"],
}
"""Zenoh messages that each right of a role allows."""
_OUT: Final = "what the plant lets out"
_ASKING: Final = [f"{OPERATOR} {right}" for right in ("watches", "asks")]
"""Rules by which operators send requests, and see which runs there are."""


def access_control(roles: Iterable[Role], kind: str | None) -> dict[str, Any]:
    """Return Zenoh's ``access_control``, which denies everything that no role allows.

    All traffic passes through the plant's sessions and is checked on arrival. Outgoing messages are not checked:
    only subscribers receive them, and subscribing is checked.

    Args:
        roles: Roles of the run.
        kind: Kind of credentials, ``certificate`` or ``password``. None: no credentials, every peer has the only
            role.
    """
    others = [role for role in roles if role.name != PLANT or role.puts]
    rules = [_rule(_OUT, ["egress"], ["put", "reply", *_DECLARED], ["**"])]
    policies: list[dict[str, Any]] = []
    for role in others:
        own = [
            _rule(f"{role.name} {right}", ["ingress"], messages, keys)
            for right, messages in _MESSAGES.items()
            if (keys := list(getattr(role, right)))
        ]
        rules += own
        policies.append({"rules": [_OUT, *(rule["id"] for rule in own)], "subjects": [role.name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [
            {"id": role.name, **({} if kind is None else {_SUBJECT[kind]: [role.name]})} for role in others
        ],
        "policies": policies,
    }


def part_of(access: dict[str, Any], *, operators: bool, asking: bool = False) -> dict[str, Any]:
    """Return the part of an access control for the session of operators, or for the session that cells join.

    Args:
        access: Access control of all roles.
        operators: Whether it is the session of operators.
        asking: Whether operators may send requests to the other session, too.
    """
    retained = {name for one in access["subjects"] if ((name := one["id"]) == OPERATOR) == operators}
    policies = [
        {**one, "subjects": own}
        for one in access["policies"]
        if (own := [s for s in one["subjects"] if s in retained])
    ]
    if asking and not operators:
        retained.add(OPERATOR)
        policies.append({"rules": [_OUT, *_ASKING], "subjects": [OPERATOR]})
    subjects = [one for one in access["subjects"] if one["id"] in retained]
    return {**access, "subjects": subjects, "policies": policies}


def router_access(access: dict[str, Any], kind: str) -> dict[str, Any]:
    """Return the access control of a router: that of all roles, and the plant's, which connects there.

    Args:
        access: Access control of all other roles.
        kind: Kind of credentials, ``certificate`` or ``password``.
    """
    plant = access_control([PLANT_AT_ROUTER], kind)
    rules = [rule for rule in plant["rules"] if rule["id"] != _OUT]
    # The router passes on queries and declarations, not only what it owns itself.
    passes = _rule(
        _OUT, ["egress"], ["put", "reply", "query", "liveliness_query", *_WATCHED, *_DECLARED], ["**"]
    )
    others = [rule for rule in access["rules"] if rule["id"] != _OUT]
    return {
        **access,
        "rules": [passes, *others, *rules],
        "subjects": [*access["subjects"], *plant["subjects"]],
        "policies": [*access["policies"], *plant["policies"]],
    }


def open_gate() -> AccessPolicy:
    """Return an access policy that lets any peer listen to a run and send requests, and denies everything else."""
    from bus.transports.zenoh.session import AccessPolicy

    return AccessPolicy(None, json.dumps(access_control([OPERATORS], None)), json.dumps(QUESTION_LIMITS))


_WATCHED: Final = ["declare_liveliness_subscriber"]
_DECLARED: Final = ["declare_subscriber", "declare_queryable", "liveliness_token"]
"""Declarations that the plant's session forwards: subscribers, queryables and liveliness tokens."""


def _rule(name: str, flows: list[str], messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": flows, "messages": messages, "key_exprs": keys}
