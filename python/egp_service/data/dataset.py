"""Drive data of one surface: a Parquet file with metadata that describe units and origin.

A row is one control period: the GP input `z` at its start, the change `y` of `[v_x, v_y, omega]`
over it, and its position (`trajectory`, `step`). Rows of one trajectory with consecutive steps are
consecutive in time, so a rollout can be replayed from the file. Where the tilt of the road was
measured, `y` is the change without that by gravity, and the columns `grade` and `bank` state it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import polars as pl

from egp_service._core import GRAVITY, MIN_SLIP_SPEED, EgpError
from egp_service.data.provenance import Provenance
from egp_service.data.table import UNREADABLE
from egp_service.files import read_bytes, replacing
from egp_service.quantities import GP_INPUT, GP_OUTPUT, NY, NZ, TILT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from egp_service._core import VehicleParameters

SCHEMA: Final = 1
METADATA_KEY: Final = "egp"
LEAST_SPEED: Final = 5.0
"""`least_speed` of a vehicle of full size, m/s."""
_INDEX: Final = ("trajectory", "step")
# By the annotation of a field of `Provenance`: types in JSON, and how they are called.
_TYPES: Final = {
    "float": ((int, float), "a number"),
    "int": ((int,), "a whole number"),
    "str": ((str,), "a text"),
    "bool": ((bool,), "true or false"),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Dataset:
    """Transitions `z` (n, 6) to `y` (n, 3) with their trajectory and step, in SI units.

    `tilt` (n, 2) is the grade and bank of the road in rad, as `quantities.TILT` defines them, or
    None if they were not measured. With them `y` is the change on a level road, so that members
    describe the vehicle and not the place. `gaps` has the lengths in s of the gaps of an imported
    log; the file does not state them. Where models are fitted and compared, transitions above
    `least_speed` (m/s) count, which the file does not state either: slip angles mean little below
    it.
    """

    z: NDArray[np.float64]
    y: NDArray[np.float64]
    trajectory: NDArray[np.uint32]
    step: NDArray[np.uint32]
    provenance: Provenance
    gaps: tuple[float, ...] = ()
    tilt: NDArray[np.float64] | None = None
    least_speed: float = LEAST_SPEED

    def __post_init__(self) -> None:
        """Check shapes and values; users of a dataset need no further checks."""
        n = len(self.z)
        shapes: dict[str, tuple[NDArray[Any], tuple[int, ...]]] = {
            "z": (self.z, (n, NZ)),
            "y": (self.y, (n, NY)),
            "trajectory": (self.trajectory, (n,)),
            "step": (self.step, (n,)),
        }
        for name, (array, shape) in shapes.items():
            if array.shape != shape:
                raise EgpError(f"{name} has shape {array.shape}: expected {shape}")
        for name, numbers in (("trajectory", self.trajectory), ("step", self.step)):
            _check_numbers(name, numbers)
        if n == 0:
            raise EgpError("the dataset is empty: expected at least one transition")
        checked: list[tuple[dict[str, str], NDArray[np.float64]]]
        checked = [(GP_INPUT, self.z), (GP_OUTPUT, self.y)]
        if self.tilt is not None:
            if self.tilt.shape != (n, len(TILT)):
                raise EgpError(f"tilt has shape {self.tilt.shape}: expected {(n, len(TILT))}")
            checked.append((TILT, self.tilt))
        for names, values in checked:
            bad = np.argwhere(~np.isfinite(values))
            if len(bad):
                row, column = bad[0]
                value = values[row, column]
                raise EgpError(f"column {list(names)[column]}, row {row} is {value}: not finite")

    def __len__(self) -> int:
        """Count the transitions."""
        return len(self.z)

    @property
    def counts(self) -> NDArray[np.bool_]:
        """Whether each transition (n,) is above `least_speed`."""
        return np.asarray(self.z[:, 0] > self.least_speed)

    @property
    def follows(self) -> NDArray[np.bool_]:
        """Whether each transition but the first (n - 1,) continues the one before it."""
        return self.unbroken(1)

    def unbroken(self, periods: int) -> NDArray[np.bool_]:
        """Whether the row `periods` rows after each row is as many periods later (n - periods,)."""
        last = np.arange(periods, len(self))
        first = last - periods
        same = self.trajectory[first] == self.trajectory[last]
        return np.asarray(same & (self.step[last].astype(np.int64) - self.step[first] == periods))

    @property
    def by_gravity(self) -> NDArray[np.float64]:
        """Changes (n, 3) of `[v_x, v_y, omega]` by gravity along the tilted road, not part of `y`.

        They are `-g dt [sin(grade), cos(grade) sin(bank), 0]`, and zero without a tilt.
        """
        found = np.zeros((len(self), NY))
        if self.tilt is not None:
            grade, bank = self.tilt.T
            found[:, 0] = -GRAVITY * self.provenance.dt * np.sin(grade)
            found[:, 1] = -GRAVITY * self.provenance.dt * np.cos(grade) * np.sin(bank)
        return found

    def of_vehicle(self, vehicle: VehicleParameters | None) -> Dataset:
        """Return the dataset with the least speed of a vehicle, in proportion to its slip speed."""
        if vehicle is None:
            return self
        share = vehicle.slip_speed / MIN_SLIP_SPEED
        return dataclasses.replace(self, least_speed=LEAST_SPEED * share)

    def select(self, rows: NDArray[Any]) -> Dataset:
        """Return the given rows (indices or mask) as a dataset of the same provenance."""
        return dataclasses.replace(
            self,
            z=self.z[rows],
            y=self.y[rows],
            trajectory=self.trajectory[rows],
            step=self.step[rows],
            gaps=(),
            tilt=None if self.tilt is None else self.tilt[rows],
        )

    def relabelled(self, surface: str, friction: float) -> Dataset:
        """Return the dataset under another name and nominal friction of the surface."""
        origin = dataclasses.replace(self.provenance, surface=surface, friction=friction)
        return dataclasses.replace(self, provenance=origin)

    def digest(self) -> str:
        """Return the SHA-256 hash of z, y, trajectory and step, independent of the file format."""
        sha = hashlib.sha256()
        for array, kind in (
            (self.z, "<f8"),
            (self.y, "<f8"),
            (self.trajectory, "<u4"),
            (self.step, "<u4"),
        ):
            sha.update(np.ascontiguousarray(array, dtype=kind).tobytes())
        return sha.hexdigest()

    def write(self, path: str | Path) -> None:
        """Write the file atomically; `OSError` as for `replacing`."""
        units = GP_INPUT | GP_OUTPUT
        numbers = np.hstack([self.z, self.y])
        if self.tilt is not None:
            units, numbers = units | TILT, np.hstack([numbers, self.tilt])
        frame = pl.DataFrame(
            dict(zip(units, numbers.T, strict=True))
            | {"trajectory": self.trajectory, "step": self.step}
        )
        metadata = {
            "schema": SCHEMA,
            "units": units,
            **self.provenance.metadata(),
        }
        content = io.BytesIO()  # polars opens only files whose names are UTF-8
        frame.write_parquet(content, metadata={METADATA_KEY: json.dumps(metadata, sort_keys=True)})
        with replacing(Path(path)) as beside:
            beside.write_bytes(content.getbuffer())

    @staticmethod
    def read(path: str | Path) -> Dataset:
        """Read and check a file of `write` or of another tool with the same schema.

        Raises:
            EgpError: if the file is missing, unreadable or invalid; the message names the file and
                the problem.

        """
        path = Path(path)
        if path.is_dir():
            raise EgpError(f"{path}: this is a folder; name the .parquet file in it")
        if not path.is_file():
            raise EgpError(f"{path}: no such file")
        content = io.BytesIO(read_bytes(path))
        try:
            provenance, tilted = _provenance(pl.read_parquet_metadata(content))
            frame = pl.read_parquet(content)
            _check_columns(frame, [*GP_INPUT, *GP_OUTPUT, *(TILT if tilted else ())])
            return Dataset(
                z=frame.select(*GP_INPUT).to_numpy().astype(np.float64),
                y=frame.select(*GP_OUTPUT).to_numpy().astype(np.float64),
                trajectory=_numbers(frame, "trajectory"),
                step=_numbers(frame, "step"),
                provenance=provenance,
                tilt=frame.select(*TILT).to_numpy().astype(np.float64) if tilted else None,
            )
        except UNREADABLE as error:
            raise EgpError(
                f"{path}: not a readable Parquet file ({error}); `egp collect --from-log` makes a "
                "dataset of a log"
            ) from error
        except EgpError as error:
            raise EgpError(f"{path}: {error}") from error


def _numbers(frame: pl.DataFrame, name: str) -> NDArray[np.uint32]:
    numbers = frame[name].to_numpy()
    _check_numbers(name, numbers)
    return numbers.astype(np.uint32)


def _check_numbers(name: str, numbers: NDArray[Any]) -> None:
    """Check numbers of trajectories or steps, of which a conversion would make other ones."""
    if numbers.dtype.kind not in "iu":
        raise EgpError(f"{name} has the type {numbers.dtype}: expected integers")
    wrong = np.flatnonzero((numbers < 0) | (numbers >= 2**32))
    if len(wrong):
        raise EgpError(f"{name}, row {wrong[0]} is {numbers[wrong[0]]}: expected 0 to {2**32 - 1}")


def merge(datasets: Sequence[Dataset]) -> Dataset:
    """Join datasets of one surface; trajectories are renumbered so that they stay distinct.

    Raises:
        EgpError: if there is none, they differ in dt, vehicle, surface or friction, only some state
            the tilt of the road, or two have the same transitions, which would be among training
            and held-out data at once.

    """
    if not datasets:
        raise EgpError("cannot merge: expected at least one dataset, got none")
    first = datasets[0].provenance
    for other in (dataset.provenance for dataset in datasets[1:]):
        for field in ("dt", "vehicle", "surface", "friction"):
            ours, theirs = getattr(first, field), getattr(other, field)
            if ours != theirs:
                raise EgpError(f"cannot merge: {field} is {ours} in one and {theirs} in another")
    tilts = [dataset.tilt for dataset in datasets if dataset.tilt is not None]
    if len(tilts) not in (0, len(datasets)):
        raise EgpError(
            f"cannot merge: {len(tilts)} of {len(datasets)} datasets of surface '{first.surface}' "
            "state the road's grade or bank; import all with these columns, or none"
        )
    digests = [dataset.digest() for dataset in datasets] if len(datasets) > 1 else []
    if len(set(digests)) < len(digests):
        again = next(n for n, digest in enumerate(digests) if digest in digests[:n])
        raise EgpError(
            f"cannot merge: numbers {digests.index(digests[again]) + 1} and {again + 1} of the "
            f"datasets of surface '{first.surface}' ({datasets[again].provenance.method}) have the "
            "same transitions: give each once"
        )
    numbers: list[NDArray[np.uint32]] = []
    used = 0
    for dataset in datasets:
        distinct, number = np.unique(dataset.trajectory, return_inverse=True)
        numbers.append((number + used).astype(np.uint32))
        used += len(distinct)
    return Dataset(
        z=np.concatenate([dataset.z for dataset in datasets]),
        y=np.concatenate([dataset.y for dataset in datasets]),
        trajectory=np.concatenate(numbers),
        step=np.concatenate([dataset.step for dataset in datasets]),
        provenance=dataclasses.replace(
            first,
            method=" + ".join(dict.fromkeys(d.provenance.method for d in datasets)),
            force_from_a_x=any(d.provenance.force_from_a_x for d in datasets),
        ),
        gaps=tuple(gap for dataset in datasets for gap in dataset.gaps),
        tilt=np.concatenate(tilts) if tilts else None,
        least_speed=datasets[0].least_speed,
    )


def check_one_car(origins: Sequence[Provenance], what: str) -> None:
    """Errors if data differ in period or vehicle; `what` they are used for has one of each."""
    first = origins[0]
    for other in origins:
        if (other.dt, other.vehicle) != (first.dt, first.vehicle):
            raise EgpError(
                f"surface {other.surface} has dt {other.dt} and vehicle {other.vehicle}, surface "
                f"{first.surface} has dt {first.dt} and vehicle {first.vehicle}: one {what} has "
                "one dt and one vehicle"
            )


def _provenance(metadata: dict[str, str]) -> tuple[Provenance, bool]:
    """Read the metadata of `Dataset.write`; other schemas, units, keys or types are errors.

    Returns the provenance, and whether the file states the tilt of the road.
    """
    text = metadata.get(METADATA_KEY)
    if text is None:
        raise EgpError(
            f"no '{METADATA_KEY}' metadata: not written by `egp collect`; "
            "import other logs with `egp collect --from-log`"
        )
    try:
        fields = json.loads(text)
    except json.JSONDecodeError as error:
        raise EgpError(f"the '{METADATA_KEY}' metadata are not JSON ({error})") from error
    if not isinstance(fields, dict):
        raise EgpError(
            f"the '{METADATA_KEY}' metadata are a {type(fields).__name__}: expected an object"
        )
    schema, units = fields.pop("schema", None), fields.pop("units", None)
    if schema != SCHEMA:
        raise EgpError(f"dataset schema {schema}: this version reads schema {SCHEMA}")
    tilted = units == GP_INPUT | GP_OUTPUT | TILT
    if not tilted and units != GP_INPUT | GP_OUTPUT:
        raise EgpError(
            f"units are {units}: expected {GP_INPUT | GP_OUTPUT}, and {TILT} where they are known"
        )
    expected = {field.name: str(field.type) for field in dataclasses.fields(Provenance)}
    fields = {"force_from_a_x": False, **fields}
    if fields.keys() != expected.keys():
        raise EgpError(f"metadata keys {sorted(fields)}: expected {sorted(expected)}")
    for name, value in fields.items():
        types, called = _TYPES[expected[name]]
        if isinstance(value, bool) != (types == (bool,)) or not isinstance(value, types):
            raise EgpError(f"{name} is {value!r} in the metadata: expected {called}")
    return Provenance(**fields), tilted


def _check_columns(frame: pl.DataFrame, names: Sequence[str]) -> None:
    """Errors unless the columns `names` are numbers, and there are those of the position."""
    for name in names:
        if name not in frame.columns:
            raise EgpError(f"column {name} is missing: found {frame.columns}")
        if not frame[name].dtype.is_float():
            raise EgpError(f"column {name} is {frame[name].dtype}: expected floating point")
    for name in _INDEX:
        if name not in frame.columns:
            raise EgpError(f"column {name} is missing: found {frame.columns}")
        if not frame[name].dtype.is_integer():
            raise EgpError(f"column {name} is {frame[name].dtype}: expected integers")
    for name in (*names, *_INDEX):
        if frame[name].null_count():
            raise EgpError(f"column {name} has {frame[name].null_count()} empty values")
