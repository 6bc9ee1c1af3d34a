"""Packages that only an extra installs."""

from typing import Final

EXTRAS: Final = {
    "torch": "train",
    "gpytorch": "train",
    "botorch": "train",
    "polars": "data",
    "scipy": "train",
    "matplotlib": "viz",
    "cvxpy": "paper",
    "osqp": "paper",
    "ray": "cluster",
    "cryptography": "security",
    "gymnasium": "gym",
    "starlette": "monitor",
    "uvicorn": "monitor",
    "rerun": "view",
    "rerun_cli": "view",
    "rosbags": "ros2",
    "ruamel": "ros2",
    "xxhash": "ros2",
}
"""Name of each package, with the extra that installs it."""
