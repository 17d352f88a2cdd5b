"""Localisation in a map that is known: the robot is searched for in the whole of it, then tracked; it never changes."""
