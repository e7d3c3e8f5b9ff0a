"""Runs a command in a network namespace of its own, whose one link is a TUN device that the caller carries.

    python -m tests.system.inside SOCKET OWN PEER COMMAND...

SOCKET is the number of a Unix socket, over which the device's file goes to the caller, or words on why there is none.
OWN and PEER are the addresses of the link's two ends.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import socket
import struct
import subprocess
import sys
from pathlib import Path

_NEW_NET, _NEW_USER = 0x4000_0000, 0x1000_0000
_SET_INTERFACE, _TUN, _NO_HEADER = 0x4004_54CA, 0x0001, 0x1000


def main(caller: socket.socket, own: str, peer: str, command: list[str]) -> None:
    try:
        _leave()
        device = _device(own, peer)
    except OSError as error:
        caller.send(f"{error}".encode())
        return
    socket.send_fds(caller, [b"ready"], [device])
    os.close(device)
    caller.recv(1)  # the caller carries packets from here on
    caller.close()
    os.execvp(command[0], command)


def _leave() -> None:
    """Into a new namespace; who is not the superuser becomes it in a namespace of users."""
    libc = ctypes.CDLL(None, use_errno=True)
    user, group = os.geteuid(), os.getegid()
    if libc.unshare(_NEW_NET if user == 0 else _NEW_NET | _NEW_USER) != 0:
        raise OSError(ctypes.get_errno(), "network namespaces are not permitted here")
    if user != 0:
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"0 {user} 1")
        Path("/proc/self/gid_map").write_text(f"0 {group} 1")


def _device(own: str, peer: str) -> int:
    """The end of a TUN device that is not in this namespace's network: what is sent there is read here."""
    if shutil.which("ip") is None:
        raise OSError("the command ip is not installed")
    try:
        device = os.open("/dev/net/tun", os.O_RDWR)
        fcntl.ioctl(device, _SET_INTERFACE, struct.pack("16sH22x", b"mdms", _TUN | _NO_HEADER))
    except OSError as error:
        raise OSError(error.errno, f"no TUN device: {error.strerror}") from None
    for line in ("link set lo up", f"addr add {own} peer {peer} dev mdms", "link set mdms up"):
        if subprocess.run(["ip", *line.split()], check=False).returncode != 0:
            raise OSError(f"ip {line} failed")
    return device


if __name__ == "__main__":
    main(socket.socket(fileno=int(sys.argv[1])), sys.argv[2], sys.argv[3], sys.argv[4:])
