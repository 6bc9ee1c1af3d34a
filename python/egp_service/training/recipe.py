"""A library's recipe: the settings of collection and training in one TOML file.

The shipped demo library is made by `shipped/demo-recipe.toml`; `egp train --recipe` makes it again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import platform
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from egp_service._core import EgpError
from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.experiment import Experiment, tool
from egp_service.data.exploration import ExplorationSettings
from egp_service.data.sampling import SamplingBounds
from egp_service.files import read_toml
from egp_service.shipped import DEMO_RECIPE
from egp_service.training.export import export
from egp_service.training.on_policy import OnPolicySettings, distinct_surfaces, drive_laps
from egp_service.training.train import TrainingSettings, check_one_library, train

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from contextlib import AbstractContextManager

    from _typeshed import DataclassInstance

    from egp_service.data.dataset import Dataset
    from egp_service.training.train import FitProgress
    from egp_service.training.trained import TrainedMember

Settings = TypeVar("Settings", bound="DataclassInstance")


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
            EgpError: if the file is not readable or has unknown or invalid fields, which it names,
                or if its surfaces do not make one library.

        """
        content = read_toml(path)[1]
        try:
            collection = content.pop("collection", {})
            training = _settings(TrainingSettings, content.pop("training", {}))
            on_policy = _settings(OnPolicySettings, content.pop("on_policy", {}))
            exploration = _settings(ExplorationSettings, collection.pop("exploration", {}))
            sampling = _settings(SamplingBounds, collection.pop("sampling", {}))
            nested = {"exploration": exploration, "sampling": sampling}
            settings = _settings(CollectionSettings, collection | nested)
            surfaces = content.pop("surface")
            experiments = tuple(_settings(Experiment, content | surface) for surface in surfaces)
            _check_surfaces(experiments)
            if on_policy.rounds > 0:
                distinct_surfaces(experiments)
        except EgpError as error:
            raise EgpError(f"{path}: {error}") from error
        except (AttributeError, TypeError, KeyError) as error:
            reason = f"no table {error}" if isinstance(error, KeyError) else str(error)
            raise EgpError(
                f"{path}: not a valid recipe: {reason.replace('.__init__()', '')}; "
                f"{DEMO_RECIPE} is an example"
            ) from error
        return Recipe(experiments, settings, training, on_policy)


def _check_surfaces(experiments: Sequence[Experiment]) -> None:
    """Errors if training would reject the data of these experiments once they are collected."""
    if not experiments:
        raise EgpError("no surfaces: add a table [[surface]] with label and friction for each")
    check_one_library([experiment.provenance("") for experiment in experiments])
    for number, experiment in enumerate(experiments):
        if experiment in experiments[:number]:
            raise EgpError(
                f"surface {experiment.label!r} with seed {experiment.seed} is stated twice, which "
                "would give the same data twice: state another seed, or leave one of them out"
            )


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


def _settings(kind: type[Settings], table: Mapping[str, Any]) -> Settings:
    """Make frozen settings of a table of TOML, whose lists become tuples.

    Raises:
        EgpError: if a value does not have the type of the setting's default, or is no text where
            there is none.

    """
    values = {
        name: tuple(value) if isinstance(value, list) else value for name, value in table.items()
    }
    for field in dataclasses.fields(kind):
        default = "wet" if str(field.type) == "str" else field.default
        if field.name in values and not _is_like(values[field.name], default):
            example = list(default) if isinstance(default, tuple) else default
            raise EgpError(
                f"{field.name} is {table[field.name]!r}: expected a value such as {example!r}"
            )
    return kind(**values)


def _is_like(value: object, default: object) -> bool:
    """Return whether a value has the type of a default, and as many numbers as this one."""
    if isinstance(default, tuple):
        return (
            isinstance(value, tuple)
            and (isinstance(default[0], str) or len(value) == len(default))
            and all(_is_like(item, default[0]) for item in value)
        )
    if isinstance(default, float):
        return isinstance(value, float) or _is_like(value, 0)
    if isinstance(default, int):
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, str) or not isinstance(default, str)
