"""cell_firmware.effects.clock."""
