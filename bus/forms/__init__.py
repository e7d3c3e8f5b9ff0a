"""The two wire forms, one a file, and their names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal, NamedTuple

from bus.forms.cells import CellsHost, CellsMember
from bus.forms.form import HostForm, MemberForm, Wiring
from bus.forms.packed import PackedHost, PackedMember

FormName = Literal["packed", "cells"]


class Form(NamedTuple):
    """Both sides of a form."""

    host: Callable[[Wiring], HostForm]
    member: Callable[[Wiring, int], MemberForm]


FORMS: Final[dict[FormName, Form]] = {
    "packed": Form(PackedHost, PackedMember),
    "cells": Form(CellsHost, CellsMember),
}
