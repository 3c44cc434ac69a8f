"""Scenes and clocks for measurements."""
