"""The two wire forms, one a file, and their names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal, NamedTuple

from bus.wire.format import HostForm, MemberForm, Wiring
from bus.wire.packed import PackedHost, PackedMember
from bus.wire.per_cell import CellsHost, CellsMember

FormName = Literal["packed", "cells"]


class Form(NamedTuple):
    """Both sides of a form."""

    host: Callable[[Wiring], HostForm]
    member: Callable[[Wiring, int], MemberForm]


FORMS: Final[dict[FormName, Form]] = {
    "packed": Form(PackedHost, PackedMember),
    "cells": Form(CellsHost, CellsMember),
}
