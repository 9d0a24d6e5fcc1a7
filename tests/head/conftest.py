from __future__ import annotations

import sys
from pathlib import Path

_HERE = Path(__file__).parent
sys.path.insert(0, str(_HERE / "adjustment"))  # bundles
sys.path.insert(0, str(_HERE.parent / "results"))  # damage_support
sys.path.insert(0, str(_HERE))  # support modules are shared by the tests of this folder
