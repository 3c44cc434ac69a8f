"""glTF 2.0 and GLB: JSON and NumPy, one concern a file."""

from .reader import read

__all__ = ["read"]
