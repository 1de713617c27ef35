"""Where real data are, which are not part of the package; see the README beside them."""

from __future__ import annotations

import os
from pathlib import Path

_GIVEN = Path(os.environ.get("MOMAPOS_SHARED", Path(__file__).parents[2] / "shared"))
DATA = _GIVEN / "data" if (_GIVEN / "data").is_dir() else _GIVEN
"""The folder that holds bestman/; it need not exist."""
TOOLS = DATA.parent / "tools"
"""Independent checks of our files; it need not exist."""
