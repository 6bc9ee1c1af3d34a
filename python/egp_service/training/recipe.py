"""A library's recipe: the settings of collection and training in one TOML file.

The shipped demo library is made by `shipped/demo-recipe.toml`; `egp train --recipe` makes it again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import platform
import tempfile
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from egp_service._core import EgpError
from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.experiment import Experiment, tool
from egp_service.files import read_toml
from egp_service.simulation.configuration import build
from egp_service.training.export import export
from egp_service.training.on_policy import OnPolicySettings, distinct_surfaces, drive_laps
from egp_service.training.train import TrainingSettings, check_one_library, train

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    from egp_service.data.dataset import Dataset
    from egp_service.training.train import FitProgress
    from egp_service.training.trained import TrainedMember


@dataclasses.dataclass(frozen=True)
class _File:
    """The content of a recipe's file: its tables, and fields of `Experiment` for all surfaces."""

    surface: tuple[dict[str, object], ...] = ()
    collection: CollectionSettings = dataclasses.field(default_factory=CollectionSettings)
    training: TrainingSettings = dataclasses.field(default_factory=TrainingSettings)
    on_policy: OnPolicySettings = dataclasses.field(default_factory=OnPolicySettings)
    friction: float | str | None = None
    label: str | None = None
    seed: int | None = None
    dt: float | None = None
    vehicle: int | None = None
    disturbances: dict[str, float] | None = None


_OF_SURFACES: Final = frozenset(field.name for field in dataclasses.fields(Experiment))


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
            ConfigurationError: naming the file, its table and the field, if this is unknown,
                missing or invalid.
            EgpError: naming the file, if it is not readable or its surfaces do not make one
                library.

        """
        content = read_toml(path)[1]
        file = build(_File, content, str(path))
        common = {name: content[name] for name in _OF_SURFACES if name in content}
        experiments = tuple(
            build(Experiment, common | surface, f"{path}: surface[{number}]")
            for number, surface in enumerate(file.surface)
        )
        try:
            _check_surfaces(experiments)
            if file.on_policy.rounds > 0:
                distinct_surfaces(experiments)
        except EgpError as error:
            raise EgpError(f"{path}: {error}") from error
        return Recipe(experiments, file.collection, file.training, file.on_policy)


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
        datasets = [
            collect(
                experiment,
                recipe.collection,
                jobs=jobs,
                cluster=cluster,
                report=partial(report, experiment.label),
            )
            for experiment in recipe.experiments
        ]
    with show.fitting() as report_fit:
        members = train(datasets, recipe.training, report_fit)
    for number in range(recipe.on_policy.rounds):
        with tempfile.TemporaryDirectory() as folder, show.collecting() as report:
            library = Path(folder) / "library.safetensors"
            export(library, members, recipe.training, training_provenance(recipe.training))
            datasets += drive_laps(
                library,
                recipe.experiments,
                recipe.on_policy,
                number,
                jobs=jobs,
                cluster=cluster,
                report=partial(report, "on-policy laps"),
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
