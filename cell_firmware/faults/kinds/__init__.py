"""cell_firmware.faults.kinds."""
