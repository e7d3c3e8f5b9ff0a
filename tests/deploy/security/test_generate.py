"""Keys as files: whose they are, who can read them, and that none are lost by accident."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from deploy.errors import InputError
from deploy.security.generate import generate_keys
from deploy.security.keyring import Keyring, identity_of, operator_of
from deploy.security.manifest import Kind
from deploy.security.roles import ProcessLayout
from deploy.security.verify import check_certificate
from deploy.util.output_lock import OutputLock

ROOT = Path(__file__).parents[3]
LATTICE = Lattice((r, c) for r in range(2) for c in range(2))
CUT = ProcessLayout(Partition.even(LATTICE, 2), "packed", ("cells 0", "cells 1"))
ROLES = ["plant", "cells-0", "cells-1", "operator"]
FOLDERS = [*ROLES, "router"]


def made(folder: Path, kind: Kind = "certificate", *, days: int = 1, force: bool = False) -> Path:
    generate_keys(folder, "scene", CUT, kind, hosts=["plant.example"], days=days, force=force)
    return folder


@pytest.mark.parametrize("kind", ["certificate", "password"])
def test_only_their_owner_can_read_keys(tmp_path: Path, kind: Kind) -> None:
    folder = made(tmp_path / "keys", kind)
    for path in (folder, *folder.rglob("*")):
        assert path.stat().st_mode & 0o777 == (0o700 if path.is_dir() else 0o600), path
    assert sorted(path.name for path in folder.iterdir() if path.is_dir()) == sorted(FOLDERS)


def test_a_role_s_folder_has_its_own_keys_and_nobody_signs_any_more(tmp_path: Path) -> None:
    folder = made(tmp_path / "keys")
    for role in FOLDERS:
        files = {path.name for path in (folder / role).iterdir()}
        assert files == {"authority.pem", "certificate.pem", "key.pem"}
        check_certificate(identity_of(folder / role, role), role)
    secret = {
        path.read_text() for path in folder.rglob("*") if path.is_file() and "PRIVATE" in path.read_text()
    }
    assert len(secret) == len(FOLDERS)
    assert not list(tmp_path.glob(".*"))


def test_a_password_is_its_user_s_and_the_plant_s_alone(tmp_path: Path) -> None:
    folder = made(tmp_path / "keys", "password")
    users = dict(line.split(":") for line in (folder / "plant" / "users").read_text().splitlines())
    assert (folder / "router" / "users").read_text() == (folder / "plant" / "users").read_text()
    assert list(users) == FOLDERS
    assert len(set(users.values())) == len(FOLDERS)
    for role in FOLDERS:
        identity = identity_of(folder / role, role)
        assert identity.kind == "password"
        assert (identity.user, identity.password) == (role, users[role])
        assert users[role] not in repr(identity)


def test_keys_are_replaced_on_request_alone(tmp_path: Path) -> None:
    folder = made(tmp_path / "keys")
    before = (folder / "plant" / "key.pem").read_bytes()
    with pytest.raises(InputError, match="is there already; --force"):
        made(folder)
    assert (folder / "plant" / "key.pem").read_bytes() == before
    made(folder, force=True)
    assert (folder / "plant" / "key.pem").read_bytes() != before


def test_a_folder_of_something_else_is_never_replaced(tmp_path: Path) -> None:
    precious = tmp_path / "thesis" / "thesis.tex"
    precious.parent.mkdir()
    precious.write_text("years of work")
    with pytest.raises(InputError, match="is not a folder of keys"):
        made(precious.parent, force=True)
    assert precious.read_text() == "years of work"


def test_what_can_t_be_made_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--host ä: must be"):
        generate_keys(tmp_path / "keys", "scene", CUT, "certificate", hosts=["ä"], days=1, force=False)
    assert not list(tmp_path.iterdir())


# --- whether they fit -----------------------------------------------------------------------------


def test_keys_fit_the_cut_that_they_were_made_for_and_the_hosts(tmp_path: Path) -> None:
    keyring = Keyring(made(tmp_path / "keys"))
    keyring.check(CUT, None)
    keyring.check(CUT, "plant.example")
    with pytest.raises(InputError, match=r"is for .*, not for 10.0.0.9: mdms keys --host 10.0.0.9"):
        keyring.check(CUT, "10.0.0.9")
    other = ProcessLayout(Partition.even(LATTICE, 1), "packed", ("cells 0",))
    with pytest.raises(
        InputError, match=r"made for 4 cells in 2 processes.*not for these 4 cells in 1 process"
    ):
        keyring.check(other, None)


def test_expired_certificates_are_reported_before_anything_starts(tmp_path: Path) -> None:
    keyring = Keyring(made(tmp_path / "keys", days=0))
    with pytest.raises(InputError, match="certificate has expired"):
        keyring.check(CUT, None)


def test_another_role_s_another_run_s_and_half_a_key_are_each_reported(tmp_path: Path) -> None:
    folder, other = made(tmp_path / "keys"), made(tmp_path / "other")
    own = folder / "cells-0"
    for name in ("certificate.pem", "key.pem"):
        (own / name).write_bytes((folder / "cells-1" / name).read_bytes())
    with pytest.raises(InputError, match="is cells-1's, not cells-0's"):
        Keyring(folder).check(CUT, None)
    for name in ("certificate.pem", "key.pem"):
        (own / name).write_bytes((other / "cells-0" / name).read_bytes())
    with pytest.raises(InputError, match=r"cells-0/certificate.pem: .*(signature|issuer)"):
        Keyring(folder).check(CUT, None)
    (own / "key.pem").write_bytes((folder / "cells-1" / "key.pem").read_bytes())
    with pytest.raises(InputError, match="no certificate and its key: key values mismatch"):
        Keyring(folder).check(CUT, None)
    (own / "key.pem").unlink()
    with pytest.raises(InputError, match=r"cells-0/key.pem: there is no such file"):
        Keyring(folder).check(CUT, None)


def test_a_key_that_others_can_read_is_no_secret(tmp_path: Path) -> None:
    folder = made(tmp_path / "keys")
    (folder / "cells-1" / "key.pem").chmod(0o640)
    with pytest.raises(InputError, match="others can read it, mode 0640: chmod 600"):
        Keyring(folder).check(CUT, None)


def test_an_access_control_that_lets_all_pass_is_refused(tmp_path: Path) -> None:
    folder = made(tmp_path / "keys")
    access = folder / "access.json5"
    access.write_text(
        access.read_text().replace('"default_permission": "deny"', '"default_permission": "allow"')
    )
    with pytest.raises(InputError, match="must be enabled, and deny"):
        Keyring(folder).gate()


@pytest.mark.parametrize("name", ["keys.json", "access.json5", "cells-1/authority.pem", ".", "cells-1"])
def test_certificate_authorities_that_others_can_change_are_refused(name: str, tmp_path: Path) -> None:
    folder = made(tmp_path / "keys")
    changed = folder / name
    changed.chmod(changed.stat().st_mode | 0o022)

    def used() -> None:
        keyring = Keyring(folder)
        keyring.check(CUT, None)
        keyring.gate()

    with pytest.raises(InputError, match=r"others can change it, mode 0\d\d\d: chmod go-w .*keys"):
        used()


def test_cells_and_operators_have_a_session_each(tmp_path: Path) -> None:
    keyring = Keyring(made(tmp_path / "keys"))
    inner, outer = (json.loads(gate.access) for gate in (keyring.gate(), keyring.outer_gate()))
    assert [one["id"] for one in inner["subjects"]] == ["cells-0", "cells-1"]
    assert [one["subjects"] for one in inner["policies"]] == [["cells-0"], ["cells-1"]]
    assert [one["id"] for one in outer["subjects"]] == ["operator"]
    assert [one["subjects"] for one in outer["policies"]] == [["operator"]]


def test_a_folder_without_keys_is_none(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"--keys .*: is no folder of keys, there is no keys.json: mdms keys"
    ):
        Keyring(tmp_path)


@pytest.mark.parametrize("name", ["", "."])
def test_keys_are_not_made_in_the_working_folder(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"DIR must name a folder to be made, not '\.', the working one"):
        generate_keys(Path(name), "scene", CUT, "certificate", hosts=[], days=1, force=False)
    assert not list(tmp_path.iterdir())


def test_an_operator_s_keys_are_found_in_the_run_s_or_alone(tmp_path: Path) -> None:
    folder = made(tmp_path / "keys")
    assert operator_of(folder) == operator_of(folder / "operator")
    with pytest.raises(InputError, match="is cells-0's, not operator's"):
        operator_of(folder / "cells-0")
    with pytest.raises(InputError, match=r"nothing/authority.pem: there is no such file"):
        operator_of(tmp_path / "nothing")


MAKER = """
import sys
from pathlib import Path
from tests.deploy.security.test_generate import made
from deploy.errors import InputError
print("ready", flush=True)
sys.stdin.readline()
try:
    made(Path(sys.argv[1]), "password", force=sys.argv[2] == "force")
except InputError as error:
    print(error)
else:
    print("made")
"""


@pytest.mark.parametrize("force", [pytest.param("force", marks=pytest.mark.slow), ""])
def test_of_several_that_make_one_folder_at_once_each_makes_it_whole_or_is_refused(
    force: str, tmp_path: Path
) -> None:
    folder = tmp_path / "keys"
    makers = [
        subprocess.Popen(
            [sys.executable, "-c", MAKER, folder, force],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        for _ in range(4)
    ]
    for maker in makers:
        assert maker.stdout is not None
        assert maker.stdout.readline() == "ready\n"
    for maker in makers:
        assert maker.stdin is not None
        maker.stdin.write("go\n")
        maker.stdin.flush()
    said = [maker.communicate(timeout=30.0) for maker in makers]
    assert [stderr for _, stderr in said if stderr] == []
    made_by = [stdout for stdout, _ in said if stdout == "made\n"]
    refused = [stdout for stdout, _ in said if stdout != "made\n"]
    assert len(made_by) >= 1
    assert len(made_by) == 1 or force
    assert all("is writing there; wait" in line or "is there already" in line for line in refused), refused
    Keyring(folder).check(CUT, None)
    users = dict(line.split(":") for line in (folder / "plant" / "users").read_text().splitlines())
    for role in ROLES:
        assert identity_of(folder / role, role).password == users[role]
    assert list(tmp_path.iterdir()) == [folder]


def test_a_draft_in_use_is_refused_and_left_alone_and_one_of_a_killed_process_is_no_hindrance(
    tmp_path: Path,
) -> None:
    draft = tmp_path / ".keys.draft"
    (draft / "keys" / "plant").mkdir(parents=True)
    (draft / "keys" / "plant" / "key.pem").write_text("half")
    with OutputLock(draft, print):
        with pytest.raises(
            InputError, match=r"^mdms keys: draft .*/\.keys\.draft: process \d+ is writing there"
        ):
            made(tmp_path / "keys", "password")
        assert (draft / "keys" / "plant" / "key.pem").read_text() == "half"
    made(tmp_path / "keys", "password")
    assert list(tmp_path.iterdir()) == [tmp_path / "keys"]
