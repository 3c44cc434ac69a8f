"""The names that arguments take. Apart from the functions that take them, because the command line lists them without torch."""

BACKENDS = ("auto", "reference", "native")
CULLS = ("none", "back", "front")
VIEWS = ("shaded", "normals", "depth", "ids", "overdraw", "bins")
