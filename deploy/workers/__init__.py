"""The processes of a run: what is started, how, and how it ends."""
