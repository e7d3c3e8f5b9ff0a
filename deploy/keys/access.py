"""The access control of the plant's session, as Zenoh reads it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from deploy.keys.roles import PLANT, Role

_SUBJECT: Final = {"certificate": "cert_common_names", "password": "usernames"}
"""By what Zenoh knows a session."""
_MESSAGES: Final = {
    "puts": ["put"],
    "hears": ["declare_subscriber"],
    "shows": ["liveliness_token"],
    "watches": ["declare_liveliness_subscriber", "liveliness_query"],
    "asks": ["query"],
}
"""Messages that each of a role's rights takes."""
_OUT: Final = "what the plant lets out"


def access_control(roles: Iterable[Role], kind: str) -> dict[str, Any]:
    """Zenoh's ``access_control``: nobody may do anything but what their role says.

    All traffic passes the plant's session, and is checked as it comes in. What goes out is not: it goes to whoever
    subscribed, and subscribing is what is checked.

    Args:
        roles: Who there is.
        kind: ``certificate`` or ``password``: how they prove who they are.
    """
    others = [role for role in roles if role.name != PLANT]
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
        "subjects": [{"id": role.name, _SUBJECT[kind]: [role.name]} for role in others],
        "policies": policies,
    }


_DECLARED: Final = ["declare_subscriber", "declare_queryable", "liveliness_token"]
"""What the plant's session tells of others: who subscribed, who is there."""


def _rule(name: str, flows: list[str], messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": flows, "messages": messages, "key_exprs": keys}
