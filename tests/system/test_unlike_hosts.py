"""The same bits on unlike hosts: libraries that choose their functions by the processor choose others here."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from tests.bus.test_elementary import WITHOUT_FMA
from tests.system.running import ROOT

pytestmark = pytest.mark.slow

SCENES = (
    "align", "breadboard", "coulomb", "drifting", "elliptic", "junction", "loaded", "motors",
    "prototype", "rolling", "spots", "stream", "tall", "uneven", "worn",
)  # fmt: skip
"""Scenes with every solver but the slow ones, and most effects."""


def _digests(**environment: str) -> dict[str, str]:
    done = subprocess.run(
        [sys.executable, "-m", "tests.system.digests", *SCENES],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def test_digests_depend_on_no_feature_of_the_processor_by_which_numpy_chooses() -> None:
    chosen = _dispatched()
    if not chosen:
        pytest.skip("this NumPy has nothing to choose on this processor")
    assert _digests(NPY_DISABLE_CPU_FEATURES=" ".join(chosen)) == _digests()


def test_digests_differ_only_where_the_functions_of_the_c_library_do() -> None:
    code = "from bus.elementary import fingerprint; print(fingerprint())"
    command = [sys.executable, "-c", code]
    other = {"GLIBC_TUNABLES": WITHOUT_FMA}
    prints = {
        subprocess.run(
            command, env={**os.environ, **more}, cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout
        for more in ({}, other)
    }
    same = _digests(**other) == _digests()
    assert same or len(prints) == 2


def _dispatched() -> list[str]:
    """Return the features of this processor for which this NumPy has functions of their own."""
    core = np._core._multiarray_umath  # type: ignore[attr-defined]
    return [name for name in core.__cpu_dispatch__ if core.__cpu_features__.get(name)]
