"""What plots need of matplotlib, which draws to files here.

Raises:
    ImportError: there is no matplotlib; the text says what to install.
"""

try:
    import matplotlib
except ImportError as error:
    raise ImportError("--plots needs matplotlib, which is not installed: pip install 'bigtri[bench]' brings it") from error

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.ticker import FuncFormatter, LogLocator

__all__ = ["Axes", "FuncFormatter", "LogLocator", "LogNorm", "Normalize", "plt"]
