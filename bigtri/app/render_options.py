"""What ``bigtri render`` takes. Imports no torch; ``pictures`` does the work."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..choices import CULLS, VIEWS
from . import arguments

EXAMPLES = """\
examples:
  bigtri render duck.glb -o duck.png
  bigtri render duck.glb -o duck.png --size 1920x1080 --azimuth 120 --elevation 10 --supersample 3 --tight
  bigtri render duck.glb -o duck.png --azimuth 0 90 180    writes duck-0.png, duck-1.png, duck-2.png
  bigtri render duck.glb -o duck.gif --turntable 36        an animation; with .png, duck-00.png to duck-35.png
  bigtri render duck.glb -o duck.png --transparent         or --background white, or --background navy '#eef'
  bigtri render duck.glb -o duck.png --view all            writes duck-shaded.png, duck-normals.png, ...
  bigtri render part.stl -o part.png --orthographic --up z --elevation 90
  bigtri render room.glb -o room.png --depth room.tiff     and how far away everything is, in the model's units
  bigtri render scan.ply -o scan.png --up z --view bins --threshold 100
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = "Draw a GLB, glTF, OBJ, PLY, STL or OFF file, seen from around it."
    parser.add_argument("model", type=Path, help="the file to draw")
    kinds = ".png, .jpg, .tif or .bmp, or for an animation .gif, .webp or .apng"
    parser.add_argument("-o", "--out", type=Path, required=True, help=f"the picture to write: {kinds}")
    parser.add_argument("--strict", action="store_true", help="draw nothing if the file has what the picture would not show")
    parser.add_argument("--size", type=arguments.size, default=(1280, 960), metavar="WxH", help="pixels (default: 1280x960)")
    parser.add_argument("--view", choices=(*VIEWS, "all"), default="shaded", help="what to show (default: %(default)s)")
    behind = parser.add_argument_group("background, shaded view only")
    about = "one colour, or one at the top and one at the bottom: names, r,g,b from 0 to 255, or '#rrggbb' (default: a sky)"
    behind.add_argument("--background", type=arguments.color, nargs="+", metavar="COLOR", help=about)
    behind.add_argument("--transparent", action="store_true", help="none: an alpha channel says where the model is")
    camera = parser.add_argument_group("camera")
    _add_azimuths(camera)
    add_camera(camera)
    _add_depth(parser.add_argument_group("depth"))
    bins = parser.add_argument_group("the view bins")
    about = "px of the bounding box above which a triangle is shown in bins (default: 4000, as in drawing)"
    bins.add_argument("--threshold", type=arguments.whole(0), metavar="PX", help=about)
    bins.add_argument("--triangle", type=arguments.whole(0), metavar="N", help="show this one alone, counted from 0")
    quality = parser.add_argument_group("quality")
    about = "NxN samples a pixel, shaded view only (default: 2)"
    quality.add_argument("--supersample", type=arguments.whole(1), default=2, metavar="N", help=about)
    quality.add_argument("--cull", choices=CULLS, default="none", help="faces not to draw (default: none)")
    arguments.add_execution(parser)


def add_camera(camera: argparse._ArgumentGroup) -> None:
    """Adds what says where one camera stands and what it sees; ``pictures.cameras_of`` makes it."""
    # What is not given is None, so that it can be told whether it goes with the rest; ``pictures`` has the values.
    camera.add_argument("--elevation", type=float, help="degrees above the horizon (default: 20)")
    camera.add_argument("--distance", type=float, help="1 fits the model, 2 is twice as far (default: 1)")
    camera.add_argument("--tight", action="store_true", help="fit the picture to what is seen of the model, and not to a sphere")
    camera.add_argument("--fov", type=float, help="vertical field of view, degrees (default: 40)")
    camera.add_argument("--orthographic", action="store_true", help="no perspective: parallel lines stay parallel")
    camera.add_argument("--up", choices=("y", "z"), help="the model's up axis (default: y)")
    about = "see it from this camera of the file, counted from 0; bigtri info says how many there are"
    camera.add_argument("--camera", type=arguments.whole(0), metavar="N", help=about)
    about = "nearest and farthest distance that is drawn, in the model's units (default: what holds the model)"
    camera.add_argument("--near", type=float, help=about)
    camera.add_argument("--far", type=float, help="see --near")


def _add_azimuths(camera: argparse._ArgumentGroup) -> None:
    about = "degrees around the up axis; several make several pictures, numbered (default: 30)"
    camera.add_argument("--azimuth", type=float, nargs="+", metavar="DEGREES", help=about)
    about = "N pictures from all around, from the azimuth on: an animation, or numbered files"
    camera.add_argument("--turntable", type=arguments.whole(1, 10_000), metavar="N", help=about)
    camera.add_argument("--fps", type=arguments.whole(1, 100), default=12, help="pictures a second of an animation (default: 12)")


def _add_depth(depth: argparse._ArgumentGroup) -> None:
    floats = ".npy or .tiff, float32 in the model's units, inf where nothing is"
    about = f"write as well how far away along the view every pixel is: {floats}; or .png, 16-bit integers, 0 where nothing is"
    depth.add_argument("--depth", type=Path, metavar="FILE", help=about)
    about = "what one unit of the model is in the .png (default: 1000: metres become millimetres); what it cannot hold is said"
    depth.add_argument("--depth-scale", type=float, metavar="COUNTS", help=about)
