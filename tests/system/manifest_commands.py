"""Commands of the manifests, as a container engine, Kubernetes or systemd would start them."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
INDEX = "metadata.annotations['batch.kubernetes.io/job-completion-index']"


@dataclass(frozen=True)
class Container:
    """A process of a manifest.

    Attributes:
        name: Name in the manifest.
        command: Arguments, the program first.
        environment: Variables that it gets.
        mounts: Path inside to name of the volume, or to the path on the host.
        before: Commands of the containers that run before it.
        probes: Commands that say whether it is well.
    """

    name: str
    command: list[str]
    environment: dict[str, str] = field(default_factory=dict)
    mounts: dict[str, str] = field(default_factory=dict)
    before: list[list[str]] = field(default_factory=list)
    probes: list[list[str]] = field(default_factory=list)


def of_compose() -> list[Container]:
    """Services of the Compose file; the image's entry point is ``mdms``."""
    services = _yaml(ROOT / "deploy" / "containers" / "compose.yaml")[0]["services"]
    return [
        Container(
            name,
            ["mdms", *service["command"]],
            mounts=dict(reversed(volume.removesuffix(":ro").split(":")) for volume in service["volumes"]),
            probes=[check["test"][1:]] if (check := service.get("healthcheck")) else [],
        )
        for name, service in services.items()
    ]


def of_kubernetes() -> list[Container]:
    """Containers of all pods; a Job with indices has as many pods as it says."""
    found: list[Container] = []
    for path in sorted((ROOT / "deploy" / "kubernetes").glob("*.yaml")):
        for document in _yaml(path):
            if document["kind"] in ("Deployment", "Job"):
                spec = document["spec"]
                pod = spec["template"]["spec"]
                found += [_of_pod(pod, str(index)) for index in range(spec.get("completions", 1))]
    return found


def _of_pod(pod: dict[str, Any], index: str) -> Container:
    (main,) = pod["containers"]
    mounts = {
        mount["mountPath"]: mount["name"]
        for container in (main, *pod["initContainers"])
        for mount in container["volumeMounts"]
    }
    return Container(
        f"{main['name']}-{index}" if _variables(main, index) else main["name"],
        _expanded(main, main["command"], index),
        _variables(main, index),
        mounts,
        [_expanded(one, one["command"], index) for one in pod["initContainers"]],
        [
            _expanded(main, probe["exec"]["command"], index)
            for key, probe in main.items()
            if key.endswith("Probe") and "exec" in probe
        ],
    )


def _variables(container: dict[str, Any], index: str) -> dict[str, str]:
    variables = container.get("env", [])
    assert all(one["valueFrom"]["fieldRef"]["fieldPath"] == INDEX for one in variables)
    return {one["name"]: index for one in variables}


def _expanded(container: dict[str, Any], command: list[str], index: str) -> list[str]:
    """The command with ``$(NAME)`` in place, as Kubernetes has it."""
    values = _variables(container, index)
    return [re.sub(r"\$\((\w+)\)", lambda found: values[found[1]], part) for part in command]


def of_systemd(instances: list[str]) -> list[Container]:
    """Units, of the one for cells as many as there are instances."""
    folder = ROOT / "deploy" / "systemd"
    settings = dict(
        line.split("=", 1) for line in (folder / "run.env").read_text().splitlines() if line[:1].isupper()
    )
    found: list[Container] = []
    for path in sorted(folder.glob("*.service")):
        text = path.read_text().replace("\\\n", " ")
        line = re.search(r"^ExecStart=(.*)$", text, re.MULTILINE)
        assert line is not None
        assert "EnvironmentFile=/etc/mdms/run.env" in text
        for instance in instances if "@" in path.stem else [""]:
            words = shlex.split(line[1].replace("%i", instance))
            # systemd puts variables in place itself, but for $$, which is a $
            command = [re.sub(r"(?<!\$)\$\{(\w+)\}", lambda has: settings[has[1]], word) for word in words]
            found.append(
                Container(path.stem + instance, [word.replace("$$", "$") for word in command], settings)
            )
    return found


def _yaml(path: Path) -> list[dict[str, Any]]:
    return [document for document in yaml.safe_load_all(path.read_text(encoding="utf-8")) if document]
