"""The PI loop that makes a motor's wheel follow a speed, in two arithmetics from one description (`SpeedLoopSpec`)."""

from cell_firmware.speed_loop.floating import SpeedLoop

__all__ = ["SpeedLoop"]
