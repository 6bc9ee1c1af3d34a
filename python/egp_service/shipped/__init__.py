"""Files that are shipped with the package: libraries, and the recipes that they were made from."""

from importlib.resources import files
from pathlib import Path
from typing import Final

_FOLDER: Final = Path(str(files(__name__)))
DEMO_LIBRARY: Final = _FOLDER / "demo-library.safetensors"
DEMO_RECIPE: Final = _FOLDER / "demo-recipe.toml"
DISTURBANCE_RECIPE: Final = _FOLDER / "disturbance-recipe.toml"
EVALUATION_LIBRARY: Final = _FOLDER / "evaluation-library.safetensors"
EVALUATION_RECIPE: Final = _FOLDER / "evaluation-recipe.toml"
