"""Distributed estimation of a parcel's pose from sensors and messages, shared by several protocols."""
