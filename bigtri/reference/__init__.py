"""The reference: every stage as one short NumPy function, and the whole as ``rasterize``. Slow, and right by inspection."""

from .binning import binning
from .depth import depth
from .pipeline import rasterize
from .records import Bins, Records
from .resolve import resolve
from .scanline import scanline
from .setup import setup
from .tile_mask import tile_mask
from .visibility import visibility

__all__ = ["Bins", "Records", "binning", "depth", "rasterize", "resolve", "scanline", "setup", "tile_mask", "visibility"]
