"""Scheduled faults, one a file.

A scene's ``[[faults]]`` are told apart by ``kind``; further kinds make ``Fault`` a union discriminated by it.
"""

from deploy.faults.crash import CrashFault

__all__ = ["CrashFault", "Fault"]

Fault = CrashFault
