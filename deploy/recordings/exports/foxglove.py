"""Export for Foxglove: an MCAP file of its own messages as protobuf, and a layout for its panels.

Twenty pictures a simulated second: transforms of the parcels (``/tf``), a grid of the cells (``/cells``), and the
colours of the grid as an image (``/image``) for viewers that don't know grids. A parcel's body is sent once, when the
parcel appears (``/parcels``), and moves with its transform.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from deploy.errors import InputError
from deploy.recordings.exports.dataset import present
from deploy.recordings.exports.extra import library
from deploy.util.colours import channels, colour
from deploy.util.files import atomic_write, write_text

if TYPE_CHECKING:
    from deploy.recordings.exports.source import RecordingSource

PICTURES_HZ: Final = 20
"""Pictures a simulated second."""
HEIGHT_M: Final = 0.05
"""Height of a parcel in the picture; recordings have none."""
WORLD: Final = "world"
_TF, _PARCELS, _CELLS, _IMAGE, _EVENTS = "/tf", "/parcels", "/cells", "/image", "/events"
_IMAGE_PX: Final = 64
"""Least size of the image's longer side, as far as whole pixels a cell go, pixels."""
_GREY = (0.88, 0.9, 0.93)
_COVERED = (0.55, 0.65, 0.8)
_FIELDS: Final = (
    *((name, "UINT8") for name in ("red", "green", "blue", "alpha")),
    *((name, "FLOAT32") for name in ("speed_m_s", "speed_x_m_s", "speed_y_m_s", "load_n")),
)
"""Fields of a cell of the grid."""
_CELL_TYPE = np.dtype([(name, np.uint8 if kind == "UINT8" else np.dtype("<f4")) for name, kind in _FIELDS])


class _Message(NamedTuple):
    topic: str
    time_ns: int
    content: Any


def export_foxglove(recording: RecordingSource, path: Path) -> list[Path]:
    """Write a recording as Foxglove's own messages, and a layout beside it, ``NAME.layout.json``.

    Raises:
        InputError: A library is not installed.
        DeployError: A file can't be written.
    """
    library("foxglove_schemas_protobuf.Grid_pb2", "the export to foxglove")
    describe = library("mcap_protobuf.schema", "the export to foxglove").build_file_descriptor_set
    from mcap.writer import Writer

    pictures = _Pictures(recording)
    with atomic_write(path) as draft, draft.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="mdms")
        numbers: dict[str, int] = {}
        for message in pictures.messages():
            if message.topic not in numbers:
                kind = message.content.DESCRIPTOR
                schema = writer.register_schema(
                    kind.full_name, "protobuf", describe(type(message.content)).SerializeToString()
                )
                numbers[message.topic] = writer.register_channel(message.topic, "protobuf", schema)
            data = message.content.SerializeToString()
            writer.add_message(numbers[message.topic], message.time_ns, data, message.time_ns)
        writer.finish()
    layout = path.with_name(f"{path.stem}.layout.json")
    write_text(layout, json.dumps(pictures.layout(), indent=2) + "\n")
    return [path, layout]


@final
class _Pictures:
    """Messages of a recording.

    Args:
        recording: The recording.
    """

    def __init__(self, recording: RecordingSource) -> None:
        self._recording = recording
        self._present = present(recording)
        cells = np.array(recording.header["cells"], dtype=np.int64).reshape(-1, 2)
        self._first = cells.min(axis=0) if len(cells) else np.zeros(2, dtype=np.int64)
        self._places = cells - self._first
        self._shape = tuple((self._places.max(axis=0, initial=0) + 1).tolist())
        self._positions = np.array(recording.header["positions_m"], dtype=np.float64).reshape(-1, 2)
        self._has_loads = True

    def messages(self) -> Iterator[_Message]:
        """Yield all messages by ascending time."""
        shown = np.zeros(self._recording.parcels.shape[1], dtype=np.bool_)
        events = sorted(self._recording.events, key=lambda event: event["time_s"])
        done = 0
        for row in self._rows():
            time_ns = int(self._recording.time_ns[row])
            while done < len(events) and events[done]["time_s"] * 1e9 <= time_ns:
                yield self._log(events[done])
                done += 1
            change = self._scene(time_ns, shown, self._present[row])
            if change is not None:
                yield change
            shown = self._present[row]
            yield self._transforms(time_ns, row)
            cells = self._grid_data(row)
            yield self._grid(time_ns, cells)
            yield self._image(time_ns, cells)

    def _rows(self) -> list[int]:
        """Instants of pictures: the nearest to each multiple of the period, the first and the last."""
        time_ns = self._recording.time_ns
        if not len(time_ns):
            return []
        wanted = np.arange(int(time_ns[0]), int(time_ns[-1]), 1_000_000_000 // PICTURES_HZ)
        return np.unique(np.append(np.searchsorted(time_ns, wanted), len(time_ns) - 1)).tolist()

    def _log(self, event: dict[str, Any]) -> _Message:
        time_ns = round(event["time_s"] * 1e9)
        message = _make("Log")
        _stamp(message.timestamp, time_ns)
        message.level = message.WARNING if event["kind"] in ("tipped", "off_array") else message.INFO
        message.name = "plant"
        parcel = "" if event.get("parcel") is None else f"parcel {event['parcel']}: "
        message.message = f"{parcel}{event['kind'].replace('_', ' ')} {event.get('detail') or ''}".strip()
        return _Message(_EVENTS, time_ns, message)

    def _scene(self, time_ns: int, before: NDArray[np.bool_], now: NDArray[np.bool_]) -> _Message | None:
        """Bodies of the parcels that appeared, and deletions of those that left; None without either."""
        if np.array_equal(before, now):
            return None
        update = _make("SceneUpdate")
        for parcel in np.flatnonzero(before & ~now).tolist():
            deletion = update.deletions.add()
            _stamp(deletion.timestamp, time_ns)
            deletion.type, deletion.id = deletion.MATCHING_ID, f"parcel {parcel}"
        for parcel in np.flatnonzero(now & ~before).tolist():
            entity = update.entities.add()
            _stamp(entity.timestamp, time_ns)
            entity.frame_id, entity.id, entity.frame_locked = f"parcel {parcel}", f"parcel {parcel}", True
            footprint = np.array(self._recording.header["footprints_m"][parcel], dtype=np.float64)
            _body(entity, footprint, channels(colour(parcel)))
        return _Message(_PARCELS, time_ns, update)

    def _transforms(self, time_ns: int, row: int) -> _Message:
        message = _make("FrameTransforms")
        for parcel in np.flatnonzero(self._present[row]).tolist():
            x, y, angle = self._recording.parcels[row, parcel, :3].tolist()
            transform = message.transforms.add()
            _stamp(transform.timestamp, time_ns)
            transform.parent_frame_id, transform.child_frame_id = WORLD, f"parcel {parcel}"
            transform.translation.x, transform.translation.y = x, y
            transform.rotation.z, transform.rotation.w = math.sin(0.5 * angle), math.cos(0.5 * angle)
        return _Message(_TF, time_ns, message)

    def _grid(self, time_ns: int, cells: NDArray[Any]) -> _Message:
        columns = self._shape[1]
        pitch = self._recording.header["pitch_m"]
        message = _make("Grid")
        _stamp(message.timestamp, time_ns)
        message.frame_id = WORLD
        if len(self._positions):
            corner = self._positions[0] - (self._places[0, ::-1] + 0.5) * pitch
            message.pose.position.x, message.pose.position.y = corner.tolist()
        message.pose.position.z = -0.001
        message.pose.orientation.w = 1.0
        message.column_count = columns
        message.cell_size.x = message.cell_size.y = pitch
        message.cell_stride, message.row_stride = _CELL_TYPE.itemsize, columns * _CELL_TYPE.itemsize
        offsets: Any = _CELL_TYPE.fields
        for name, kind in _FIELDS:
            field = message.fields.add()
            field.name, field.offset = name, offsets[name][1]
            field.type = field.NumericType.Value(kind)
        message.data = cells.tobytes()
        return _Message(_CELLS, time_ns, message)

    def _image(self, time_ns: int, cells: NDArray[Any]) -> _Message:
        """Return the cells' colours, the highest row first; white where there is no cell."""
        shades = np.stack([cells[name] for name in ("red", "green", "blue")], axis=-1)
        shades[cells["alpha"] == 0] = 255
        scale = max(1, _IMAGE_PX // max(self._shape))
        pixels = shades[::-1].repeat(scale, axis=0).repeat(scale, axis=1)
        message = _make("RawImage")
        _stamp(message.timestamp, time_ns)
        message.frame_id, message.encoding = WORLD, "rgb8"
        message.height, message.width, _ = pixels.shape
        message.step = 3 * message.width
        message.data = pixels.tobytes()
        return _Message(_IMAGE, time_ns, message)

    def _grid_data(self, row: int) -> NDArray[Any]:
        """Fields of every place of the grid, ``(rows, columns)``; a place without a cell is transparent."""
        recording = self._recording
        cells = np.zeros(len(self._places), dtype=_CELL_TYPE)
        covered = np.any(recording.held_presence.at(row), axis=1, keepdims=True)
        speeds = recording.held_wheel_speeds.at(row)
        shades = np.where(covered, _COVERED, _GREY)
        for number, name in enumerate(("red", "green", "blue")):
            cells[name] = np.rint(255 * shades[:, number])
        cells["alpha"] = 255
        cells["speed_x_m_s"], cells["speed_y_m_s"] = speeds.T
        cells["speed_m_s"] = np.hypot(speeds[:, 0], speeds[:, 1])
        if self._has_loads:
            try:
                cells["load_n"] = recording.tractions(row).load_n
            except InputError:  # a scene of another version: its loads are unknown
                self._has_loads = False
        grid = np.zeros(self._shape, dtype=_CELL_TYPE)
        grid[self._places[:, 0], self._places[:, 1]] = cells
        return grid

    def layout(self) -> dict[str, Any]:
        """Return a layout of Foxglove: the view from above, and the list of events."""
        low, high = self._positions.min(axis=0, initial=0.0), self._positions.max(axis=0, initial=0.0)
        middle = 0.5 * (low + high)
        topics = {topic: {"visible": True} for topic in (_PARCELS, _CELLS)}
        return {
            "configById": {
                "3D!array": {
                    "cameraState": {
                        "perspective": False,
                        "distance": float(1.3 * max(float((high - low).max()), 0.1)),
                        "phi": 0.0,
                        "thetaOffset": 90.0,
                        "targetOffset": [float(middle[0]), float(middle[1]), 0.0],
                        "target": [0.0, 0.0, 0.0],
                        "targetOrientation": [0.0, 0.0, 0.0, 1.0],
                        "fovy": 45.0,
                        "near": 0.01,
                        "far": 5000.0,
                    },
                    "followMode": "follow-none",
                    "followTf": WORLD,
                    "scene": {"backgroundColor": "#ffffff"},
                    "topics": topics,
                    "layers": {},
                    "imageMode": {},
                },
                "RosOut!events": {"topicToRender": _EVENTS, "minLogLevel": 1},
            },
            "globalVariables": {},
            "userNodes": {},
            "playbackConfig": {"speed": 1},
            "layout": {
                "first": "3D!array",
                "second": "RosOut!events",
                "direction": "column",
                "splitPercentage": 80,
            },
        }


def _make(name: str) -> Any:
    """An empty message of Foxglove's."""
    module = library(f"foxglove_schemas_protobuf.{name}_pb2", "the export to foxglove")
    return getattr(module, name)()


def _stamp(timestamp: Any, time_ns: int) -> None:
    timestamp.seconds, timestamp.nanos = divmod(time_ns, 1_000_000_000)


def _body(entity: Any, footprint: NDArray[np.float64], shade: tuple[float, float, float]) -> None:
    """A prism over a footprint: top and sides as triangles, and a line from its centre to its front."""
    body = entity.triangles.add()
    body.pose.orientation.w = 1.0
    body.color.r, body.color.g, body.color.b, body.color.a = *shade, 0.85
    corners = len(footprint)
    for height in (0.0, HEIGHT_M):
        for x, y in footprint.tolist():
            body.points.add(x=x, y=y, z=height)
    for i in range(1, corners - 1):
        body.indices.extend((corners, corners + i, corners + i + 1))
    for i in range(corners):
        j = (i + 1) % corners
        body.indices.extend((i, j, corners + j, i, corners + j, corners + i))
    front = entity.lines.add()
    front.type, front.thickness, front.scale_invariant = front.LINE_STRIP, 2.0, True
    front.pose.orientation.w = 1.0
    front.color.a = 1.0
    for x in (0.0, float(footprint[:, 0].max())):
        front.points.add(x=x, y=0.0, z=1.02 * HEIGHT_M)
