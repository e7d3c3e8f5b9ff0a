"""cell_firmware.effects.cop."""
