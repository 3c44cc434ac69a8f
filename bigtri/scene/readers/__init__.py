"""One reader a format: from a file's bytes to a ``Model``. ``assemble.py`` makes a ``Scene`` of what any of them read."""
