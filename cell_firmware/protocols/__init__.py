"""Bundled firmware, one a file; ``cell_firmware.loader`` knows them by name."""
