"""``runs.jsonl``: every run of a campaign as soon as it is over, one line of JSON each."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, final

from pydantic import TypeAdapter

from deploy.campaign.ending import Ending
from deploy.campaign.outcome import Outcome
from deploy.errors import DeployError, InputError

if TYPE_CHECKING:
    from deploy.campaign.cases import Case

FILE_NAME = "runs.jsonl"

_ENDING = TypeAdapter(Ending)
_OUTCOME = TypeAdapter(Outcome)


@final
class Journal:
    """The runs that are over, in the file and at hand.

    A line is written in one go and flushed: whatever ends the campaign, only the last can be torn, and that is dropped
    when the file is opened again.

    Args:
        folder: The campaign's, locked by the caller (``deploy.output_lock``).

    Raises:
        InputError: A line of the file makes no sense.
        DeployError: The file can't be opened.

    Attributes:
        runs: What each run came to, by the case's number and the seed.
        undisturbed: How each undisturbed run ended, by its key.
    """

    def __init__(self, folder: Path) -> None:
        self.runs: dict[tuple[int, int], Outcome] = {}
        self.undisturbed: dict[str, Ending] = {}
        self._path = folder / FILE_NAME
        try:
            self._file = self._path.open("ab+", buffering=0)
        except OSError as error:
            raise DeployError(f"can't open {self._path}: {error.strerror or error}") from None
        try:
            self._read()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def _read(self) -> None:
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        self._file.truncate(whole)
        for number, line in enumerate(content[:whole].splitlines(), start=1):
            try:
                self._take(json.loads(line))
            except (ValueError, KeyError, TypeError) as error:
                raise InputError(f"{self._path}: line {number} is no run of a campaign: {error!r}") from None

    def _take(self, line: Mapping[str, Any]) -> None:
        if "undisturbed" in line:
            self.undisturbed[line["undisturbed"]] = _ENDING.validate_python(line["ending"])
        else:
            self.runs[line["case"], line["seed"]] = _OUTCOME.validate_python(line)

    def add_undisturbed(self, key: str, seed: int, ending: Ending) -> None:
        """Keep how an undisturbed run ended.

        Raises:
            DeployError: It can't be written.
        """
        self._append({"undisturbed": key, "seed": seed, "ending": asdict(ending)})
        self.undisturbed[key] = ending

    def add_run(self, case: Case, seed: int, outcome: Outcome) -> None:
        """Keep what a run came to.

        Raises:
            DeployError: It can't be written.
        """
        self._append({"case": case.number, "seed": seed, "values": case.values, **asdict(outcome)})
        self.runs[case.number, seed] = outcome

    def _append(self, line: Mapping[str, Any]) -> None:
        content = json.dumps(line, ensure_ascii=False, default=str).encode() + b"\n"
        try:
            while content:
                content = content[self._file.write(content) :]
        except OSError as error:
            raise DeployError(f"can't write {self._path}: {error.strerror or error}") from error
