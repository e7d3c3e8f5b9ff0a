"""A recording read by a stranger: the libraries of its formats and the schemas in the file, nothing of ours."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from math import prod
from pathlib import Path
from typing import Any

import jsonschema
import msgpack
import numpy as np
import pytest
from mcap.reader import make_reader

from deploy.recordings.format import SCHEMAS
from deploy.recordings.writer import Recorder

Make = Callable[..., Any]
DECODERS: dict[str, Callable[[bytes], Any]] = {"json": json.loads, "msgpack": msgpack.unpackb}


def decoded(path: Path) -> Iterator[tuple[str, dict[str, Any], Any]]:
    """Topic, schema and content of every message; each obeys its schema."""
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            assert schema.encoding == "jsonschema"
            described = json.loads(schema.data)
            content = DECODERS[channel.message_encoding](message.data)
            jsonschema.Draft202012Validator(described).validate(content)
            yield channel.topic, described, content


def array(described: dict[str, Any], data: bytes) -> np.ndarray:
    """A binary as its schema's keyword ``ndarray`` describes it."""
    form = described["ndarray"]
    if form.get("bits") == "little":
        bits = np.unpackbits(np.frombuffer(data, np.uint8), count=prod(form["shape"]), bitorder="little")
        return bits.astype(form["dtype"]).reshape(form["shape"])
    return np.frombuffer(data, form["dtype"]).reshape(form["shape"])


@pytest.fixture(params=[False, True], ids=["wheels", "wheels_follow"])
def run(made_up_run: Make, request: pytest.FixtureRequest) -> Any:
    return made_up_run(
        parcels=2,
        sensors=3,
        wheels_change=True,
        wheels_follow=request.param,
        events=[{"time_s": 0.0, "kind": "tipped", "parcel": 1, "cells": [], "position_m": [0.0, 1.0]}],
        faults=[{"time_s": 0.0, "kind": "crash", "cell": [0, 0]}],
    )


def test_every_message_of_every_channel_is_decoded_by_the_file_s_own_schemas(
    tmp_path: Path, run: Any
) -> None:
    registers = {"firmware.u": np.arange(24.0).reshape(12, 2), "count": np.arange(12, dtype=np.int32)}
    messages = {"sent": np.arange(48).reshape(12, 4) % 3 == 0, "u": np.arange(48.0).reshape(12, 4)}
    trace = {"cell": np.array([3, 5]), "sent.u": np.arange(8.0).reshape(2, 4)}
    with Recorder(tmp_path, run.header) as recorder:
        run.feed(recorder)
        recorder.registers(4, 5, registers)
        recorder.messages(4, 5, messages)
        recorder.trace(4, 5, trace)
        recorder.control({"time_s": 0.03, "kind": "pause"})
        recorder.close("ok")
    rows: dict[str, list[np.ndarray]] = {"presence": [], "drives": [], "wheel_speeds": [], "parcels": []}
    seen, shown = set[str](), dict[str, np.ndarray]()
    last: dict[str, np.ndarray] = {}
    for topic, described, content in decoded(recorder.path):
        seen.add(topic)
        if topic == "/tick":
            binaries = {name: form for name, form in described["properties"].items() if "ndarray" in form}
            assert set(binaries) == set(rows)
            if "wheel_speeds" in content and content["wheel_speeds"] is None:  # as its description says
                last["wheel_speeds"] = last["drives"]
                del content["wheel_speeds"]
            last |= {name: array(form, content[name]) for name, form in binaries.items() if name in content}
            for name, value in last.items():
                rows[name].append(value)
        elif topic in ("/registers", "/messages", "/trace"):
            for name, (dtype, shape, data) in content[topic.removeprefix("/")].items():
                shown[name] = np.frombuffer(data, dtype).reshape(shape)
    assert seen == {*SCHEMAS, "/tick", "/registers", "/messages", "/trace"}
    np.testing.assert_array_equal(rows["presence"], run.presence)
    np.testing.assert_array_equal(rows["drives"][:-1], run.drives[:-1])
    np.testing.assert_array_equal(rows["wheel_speeds"], run.wheel_speeds)
    np.testing.assert_array_equal(rows["parcels"], run.states)
    for name, values in {**registers, **messages, **trace}.items():
        np.testing.assert_array_equal(shown[name], values)
        assert shown[name].dtype == values.dtype


def test_the_schemas_are_schemas(tmp_path: Path, run: Any) -> None:
    with run.record(tmp_path).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert len(summary.schemas) == len(summary.channels) == len(SCHEMAS) + 4
    for schema in summary.schemas.values():
        described = json.loads(schema.data)
        jsonschema.Draft202012Validator.check_schema(described)
        assert schema.name.startswith("mdms.")
