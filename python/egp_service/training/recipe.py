"""A library's recipe: the settings of collection and training in one TOML file.

The shipped demo library is made by `shipped/demo-recipe.toml`; `egp train --recipe` makes it again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import platform
import tempfile
import tomllib
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egp_service._core import EgpError
from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.experiment import Experiment, tool
from egp_service.data.exploration import ExplorationSettings
from egp_service.data.sampling import SamplingBounds
from egp_service.shipped import DEMO_RECIPE
from egp_service.training.export import export
from egp_service.training.on_policy import OnPolicySettings, drive_laps
from egp_service.training.train import TrainingSettings, train

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager

    from egp_service.data.dataset import Dataset
    from egp_service.training.train import FitProgress
    from egp_service.training.trained import TrainedMember


@dataclasses.dataclass(frozen=True)
class Recipe:
    """Settings of collection and training."""

    experiments: tuple[Experiment, ...]
    collection: CollectionSettings
    training: TrainingSettings
    on_policy: OnPolicySettings = dataclasses.field(default_factory=OnPolicySettings)

    @staticmethod
    def read(path: Path) -> Recipe:
        """Read a recipe.

        Raises:
            EgpError: if the file is not readable or has unknown or invalid fields, which it names.

        """
        try:
            content = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, tomllib.TOMLDecodeError) as error:
            raise EgpError(f"{path}: {error}") from error
        try:
            collection = content.pop("collection", {})
            training = TrainingSettings(**content.pop("training", {}))
            on_policy = OnPolicySettings(**_tuples(content.pop("on_policy", {})))
            exploration = ExplorationSettings(**_tuples(collection.pop("exploration", {})))
            sampling = SamplingBounds(**_tuples(collection.pop("sampling", {})))
            settings = CollectionSettings(
                **_tuples(collection), exploration=exploration, sampling=sampling
            )
            surfaces = content.pop("surface")
            experiments = tuple(Experiment(**content, **surface) for surface in surfaces)
        except (AttributeError, TypeError, KeyError) as error:
            reason = f"no table {error}" if isinstance(error, KeyError) else str(error)
            raise EgpError(
                f"{path}: not a valid recipe: {reason.replace('.__init__()', '')}; "
                f"{DEMO_RECIPE} is an example"
            ) from error
        return Recipe(experiments, settings, training, on_policy)


def collect_all(
    recipe: Recipe,
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    report: Callable[[str, int, int], None],
) -> list[Dataset]:
    """Collect every surface of the recipe, calling `report(label, done, total)` after each run."""
    datasets = []
    for experiment in recipe.experiments:

        def on_run(done: int, total: int, label: str = experiment.label) -> None:
            report(label, done, total)

        settings = recipe.collection
        datasets.append(collect(experiment, settings, jobs=jobs, cluster=cluster, report=on_run))
    return datasets


@dataclasses.dataclass(frozen=True)
class Displays:
    """Progress displays of the stages; none by default."""

    collecting: Callable[[], AbstractContextManager[Callable[[str, int, int], None]]] = lambda: (
        contextlib.nullcontext(lambda _label, _done, _total: None)
    )
    fitting: Callable[[], AbstractContextManager[Callable[[FitProgress], None]]] = lambda: (
        contextlib.nullcontext(lambda _step: None)
    )


def follow(
    recipe: Recipe,
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    displays: Displays | None = None,
) -> tuple[list[Dataset], list[TrainedMember]]:
    """Collect and train by the recipe; return all data and the members trained on them.

    After the first training, `on_policy.rounds` times, the ensemble drives laps, their data are
    added and the members are trained again.
    """
    show = displays or Displays()
    with show.collecting() as report:
        datasets = collect_all(recipe, jobs=jobs, cluster=cluster, report=report)
    with show.fitting() as report_fit:
        members = train(datasets, recipe.training, report_fit)
    for number in range(recipe.on_policy.rounds):
        with tempfile.TemporaryDirectory() as folder, show.collecting() as report:
            library = Path(folder) / "library.safetensors"
            export(library, members, recipe.training, training_provenance(recipe.training))

            def on_lap(
                done: int, total: int, report: Callable[[str, int, int], None] = report
            ) -> None:
                report("on-policy laps", done, total)

            datasets += drive_laps(
                library,
                recipe.experiments,
                recipe.on_policy,
                number,
                jobs=jobs,
                cluster=cluster,
                report=on_lap,
            )
        with show.fitting() as report_fit:
            members = train(datasets, recipe.training, report_fit)
    return datasets, members


def training_provenance(settings: TrainingSettings) -> dict[str, str]:
    """Return versions and settings of a training, without time and machine."""
    return {
        "tool": tool(),
        "python": platform.python_version(),
        "torch": version("torch"),
        "gpytorch": version("gpytorch"),
        "botorch": version("botorch"),
        "training": json.dumps(dataclasses.asdict(settings), sort_keys=True),
    }


def _tuples(values: Mapping[str, Any]) -> dict[str, Any]:
    """Turn TOML's lists into the tuples of the frozen settings."""
    return {
        name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
    }
