"""Building blocks of protocols: last messages, regions, trajectories and spectra, independent of boards."""
