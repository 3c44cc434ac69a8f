"""The backends that a test runs on, in one place."""

import pytest

from bigtri import native

needs_native = pytest.mark.skipif(not native.available(), reason="the extension is not built")
BACKENDS = ["reference", pytest.param("native", marks=needs_native)]
