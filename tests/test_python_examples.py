"""Every example of ``docs/python.md`` runs as it stands, and the public package has what it says."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import mdms

pytestmark = pytest.mark.system  # each example is a process

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
EXAMPLES = dict(re.findall(r"^## ([^\n]+)\n(?:(?!^## ).)*?^```python\n(.*?)^```", PAGE, re.S | re.M))


def _python(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    scripts = str(Path(sys.executable).parent)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": f"{scripts}:{os.environ['PATH']}"}
    (folder / "example.py").write_text(code)
    return subprocess.run(
        [sys.executable, "example.py"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=110,
    )


def test_there_are_ten_examples() -> None:
    assert len(EXAMPLES) == 10
    assert PAGE.count("```python") == 10


@pytest.mark.slow
@pytest.mark.parametrize("title", EXAMPLES)
def test_an_example_runs_as_it_stands(title: str, tmp_path: Path) -> None:
    done = _python(EXAMPLES[title], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_every_public_name_is_there_and_nothing_else() -> None:
    assert dir(mdms) == sorted(mdms.__all__)
    assert all(getattr(mdms, name) is not None for name in mdms.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = mdms.nothing  # pyright: ignore[reportAttributeAccessIssue]


def test_importing_the_package_imports_nothing_heavy(tmp_path: Path) -> None:
    done = _python(
        "import mdms, sys; print(sorted({'numba', 'zenoh', 'scipy', 'pydantic'} & set(sys.modules)))",
        tmp_path,
    )
    assert done.stdout == "[]\n"


def test_a_cell_s_program_that_imports_the_package_loads_no_more_than_the_package_itself(
    tmp_path: Path,
) -> None:
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert code is not None
    assert "from mdms import" in code[1]
    (tmp_path / "public.py").write_text(code[1])
    (tmp_path / "internal.py").write_text(
        code[1].replace("from mdms import", "from cell_firmware.cell import")
    )
    load = (
        "import sys\n"
        "from cell_firmware.loader import load\n"
        "from cell_firmware.specs import CellsSpec\n"
        "load(CellsSpec(firmware='NAME.py'))\n"
        "print(*(name for name in sys.modules if not name.startswith('mdms_firmware_')))"
    )
    internal, public = (
        set(_python(load.replace("NAME", name), tmp_path).stdout.split()) for name in ("internal", "public")
    )
    assert "cell_firmware.cell" in internal
    assert public - internal == {"mdms"}


@pytest.mark.parametrize("name", ["deploy", "plant"])
def test_a_folder_of_the_same_name_is_refused_in_a_line(name: str, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("")
    done = _python(f"import mdms; mdms.load_scene if {name == 'deploy'} else mdms.Plant", tmp_path)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith(f"ImportError: mdms needs its own package '{name}', but ")


def test_the_command_works_beside_files_and_folders_of_the_same_names(tmp_path: Path) -> None:
    for name in ("deploy/__init__", "plant/__init__", "json", "queue", "random", "matplotlib", "zenoh"):
        file = tmp_path / f"{name}.py"
        file.parent.mkdir(exist_ok=True)
        file.write_text(
            "import pathlib\npathlib.Path('imported').touch()\nraise ImportError('not this one')\n"
        )
    done = subprocess.run(
        [str(Path(sys.executable).parent / "mdms"), "run", "motors", "--duration", "0.1", "--processes", "1",
         "--output", "out"],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=110,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "overview.png").exists()
    assert not (tmp_path / "imported").exists()


def test_the_package_is_the_command(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mdms", "--version"],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=False, timeout=110,
    )  # fmt: skip
    assert (done.returncode, done.stdout[:5]) == (0, "mdms ")


def test_objects_say_what_they_are_and_travel() -> None:
    scene = mdms.load_scene("motors")
    assert pickle.loads(pickle.dumps(scene)) == scene
    with mdms.Simulation.open(scene) as simulation:
        simulation.step()
        assert repr(simulation) == "<Simulation of motors, 18 cells, at 0.004096 of 10 s>"
    assert repr(simulation).endswith("closed>")


def test_programs_that_are_no_programs_are_refused() -> None:
    for firmware, rule in ((dict, "must derive from"), (7, "must be a name, a class or a function")):
        with pytest.raises(mdms.FirmwareError, match=rule):
            mdms.load_scene({"cells": {"firmware": firmware}})


def test_a_program_that_fails_in_this_process_ends_the_run_with_its_cell() -> None:
    class Fails(mdms.CellFirmware):
        def init(self, cell: mdms.Cell) -> tuple[int, int]:
            return cell.row, cell.column

        def step(self, state: tuple[int, int], inputs: mdms.CellInputs) -> tuple[object, mdms.CellOutputs]:
            return state, mdms.CellOutputs((1.0 / (state != (0, 1)), 0.0))

    scene = mdms.load_scene(
        {
            "duration_s": 0.1,
            "array": {"rows": 2, "columns": 2},
            "cells": {"firmware": Fails},
            "parcels": [{"size_m": [0.15, 0.15], "mass_kg": 1.0, "position_m": [0.0, 0.0]}],
            "friction": {"law": "viscous", "coefficient_s_per_m": 5.0},
        }
    )
    with mdms.Simulation.open(scene) as simulation:
        result = simulation.run()
    assert result.status == "failed"
    assert result.reason.startswith("the program of cell 0,1 failed in tick 0 (0 s): ")
    assert "ZeroDivisionError" in result.detail
    with mdms.Simulation.open(scene) as simulation:  # stepped, the failure is no silent end
        with pytest.warns(
            RuntimeWarning, match=r"has ended, failed: the program of cell 0,1 failed in tick 0 \(0 s\)"
        ):
            assert simulation.step() is None
        assert simulation.step() is None
    assert "failed: the program of cell 0,1 failed in tick 0" in repr(simulation)


def test_scenes_are_changed_by_text_as_on_the_command_line() -> None:
    scene = mdms.load_scene("motors", ["parcels.0.mass_kg=3.5", "duration_s=0.25"])
    assert (scene.parcels[0].mass_kg, scene.duration_s) == (3.5, 0.25)
    assert mdms.load_scene({**SMALL, "duration_s": 1.0}, "duration_s=0.25").duration_s == 0.25
    with pytest.raises(
        mdms.InputError, match=r"mass_kg = -1: must be > 0 \(from --set parcels.0.mass_kg=-1\)"
    ):
        mdms.load_scene("motors", ["parcels.0.mass_kg=-1"])


@pytest.mark.parametrize("given", ["motors", {"duration_s": 1.0}, None])
def test_a_simulation_of_no_scene_says_where_scenes_come_from(given: Any) -> None:
    with pytest.raises(mdms.InputError, match=r"must be a scene that mdms\.load_scene has returned"):
        mdms.Simulation.open(given)


@pytest.mark.parametrize("given", [3, None])
def test_scenes_are_names_paths_or_tables(given: Any) -> None:
    with pytest.raises(mdms.InputError, match=f"scene {given}: must be a bundled name, a path, or a dict"):
        mdms.load_scene(given)


def test_worker_processes_are_not_given_a_class_that_they_cannot_import() -> None:
    class Here(mdms.CellFirmware):
        def init(self, cell: mdms.Cell) -> None:
            return None

        def step(self, state: None, inputs: mdms.CellInputs) -> tuple[None, mdms.CellOutputs]:
            return state, mdms.CellOutputs((0.0, 0.0))

    scene = mdms.load_scene({**SMALL, "cells": {"firmware": Here}})
    with pytest.raises(
        mdms.FirmwareError, match=r"Here: worker processes can't import it: define it at the top of"
    ):
        mdms.Simulation.open(scene, mdms.Workers(1))


@pytest.mark.slow
def test_backends_have_the_same_bits() -> None:
    states: list[bytes] = []
    for cells in (mdms.InProcess(), mdms.Workers(2)):
        with mdms.Simulation.open(mdms.load_scene("motors"), cells) as simulation:
            for _ in range(20):
                simulation.step()
            states.append(simulation.plant.state.tobytes())
    assert states[0] == states[1]


SMALL = {
    "duration_s": 0.1,
    "array": {"rows": 3, "columns": 3},
    "cells": {"parameters": {"field": {"kind": "uniform", "velocity_m_s": [0.1, 0.0]}}},
    "parcels": [{"size_m": [0.2, 0.2], "mass_kg": 1.0, "position_m": [0.0, 0.0]}],
    "friction": {"law": "viscous", "coefficient_s_per_m": 5.0},
}


def test_a_closed_simulation_is_not_stepped() -> None:
    simulation = mdms.Simulation.open(mdms.load_scene(SMALL))
    simulation.close()
    for use in (simulation.step, simulation.run):
        with pytest.raises(mdms.DeployError, match="is closed"):
            use()


def test_the_result_has_the_losses_of_all_ticks() -> None:
    def fails_late(
        state: tuple[int, bool] | None, inputs: mdms.CellInputs
    ) -> tuple[object, mdms.CellOutputs]:
        count = 0 if state is None else state[0]
        return (count + 1, True), mdms.CellOutputs((1.0 / (3 - count) if inputs.presence[0] else 0.0, 0.0))

    tables = {**SMALL, "cells": {"firmware": fails_late, "on_failure": "isolate"}}
    with mdms.Simulation.open(mdms.load_scene(tables)) as simulation:
        result = simulation.run()
    assert result.cells_lost > 0
    assert result.last_losses == ()
    assert {loss.tick for loss in result.losses} == {3}
