from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "results"))  # damage_support
sys.path.insert(0, str(Path(__file__).parent))  # hand_support is shared by the tests of this folder
