"""Page for live runs and recordings, in a browser on this machine."""
