"""The library file: a written file can be read, and each kind of damage has its own error."""

from __future__ import annotations

import hashlib
import json
import math
import struct
import tomllib
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from egp_service import EgpError, InvalidArgumentError
from egp_service._core import (
    Engine,
    Library,
    LibraryError,
    MemberData,
    VehicleParameters,
    write_library,
    write_library_subset,
)
from library_example import member_arrays, write_example

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray


class Content:
    """The parts of a library file, to be changed and sealed again."""

    def __init__(self, raw: bytes) -> None:
        """Take a valid file apart."""
        (length,) = struct.unpack("<Q", raw[:8])
        self.header: dict[str, Any] = json.loads(raw[8 : 8 + length])
        self.metadata = json.loads(self.header.pop("__metadata__")["egp"])
        self.tensors = {
            name: np.frombuffer(
                raw,
                "<f8",
                offset=8 + length + entry["data_offsets"][0],
                count=int(np.prod(entry["shape"])),
            )
            .reshape(entry["shape"])
            .copy()
            for name, entry in self.header.items()
        }
        self.dtypes = dict.fromkeys(self.tensors, "F64")

    def write(self, path: Path) -> None:
        """Put the parts together under a valid seal."""
        self.metadata["sha256"] = "0" * 64
        seal = hashlib.sha256(self.raw()).hexdigest()
        self.metadata["sha256"] = seal
        path.write_bytes(self.raw())

    def raw(self) -> bytes:
        """Return the file's bytes with the seal as it stands in the metadata."""
        header: dict[str, Any] = {"__metadata__": {"egp": json.dumps(self.metadata)}}
        data = b""
        for name, values in self.tensors.items():
            content = values.astype("<f4" if self.dtypes[name] == "F32" else "<f8").tobytes()
            offsets = [len(data), len(data) + len(content)]
            header[name] = {
                "dtype": self.dtypes[name],
                "shape": list(values.shape),
                "data_offsets": offsets,
            }
            data += content
        text = json.dumps(header).encode()
        return struct.pack("<Q", len(text)) + text + data


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "library.safetensors"
    write_example(path)
    return path


def refusal(path: Path) -> LibraryError:
    with pytest.raises(LibraryError) as caught:
        Library.load(path)
    return caught.value


def test_what_is_written_is_read(path: Path) -> None:
    library = Library.load(path)
    arrays = member_arrays(0.5, 30, seed=0)
    member = library.members[0]
    assert library.id == hashlib.sha256(path.read_bytes()).hexdigest()
    assert (library.dt, library.kernel, library.vehicle) == (0.05, "rbf", "commonroad-1")
    assert library.provenance == {"source": "tests"}
    assert [member.label for member in library.members] == ["friction 0.5", "friction 1.1"]
    assert (member.friction, member.dataset, member.n_points) == (0.5, "none", 30)
    for name in ("lengthscales", "outputscale", "noise", "constant", "envelope"):
        np.testing.assert_array_equal(getattr(member, name), arrays[name])
    np.testing.assert_allclose(
        member.noise_std, np.sqrt(arrays["noise"]) * arrays["target_std"], rtol=1e-15
    )
    mean, jacobian, variance = library.predict(arrays["golden_z"])
    # Both sides are exact formulas; what remains is rounding, amplified by alpha.
    np.testing.assert_allclose(mean, arrays["golden_mean"], atol=1e-12)
    np.testing.assert_allclose(jacobian, arrays["golden_jacobian"], atol=1e-12)
    np.testing.assert_allclose(variance, arrays["golden_variance"], atol=1e-12)


def test_measurement_noise_is_optional_and_the_default_of_the_setting(tmp_path: Path) -> None:
    def used(path: Path, settings: str = "") -> list[float]:
        found: list[float] = tomllib.loads(Engine(str(path), settings).settings_toml)["weights"][
            "measurement"
        ]
        return found

    with_noise, part, without = (tmp_path / name for name in ("with", "part", "without"))
    write_example(without)
    assert b"measurement_noise" not in without.read_bytes()
    assert Library.load(without).measurement_noise is None
    assert used(without) == [0.03, 0.03, 0.005]
    noise = np.array([0.007, 0.0017, 0.0008])
    write_example(with_noise, measurement_noise=noise)
    write_library_subset(with_noise, part, [1])
    for path in (with_noise, part):
        np.testing.assert_array_equal(Library.load(path).measurement_noise, noise)
        assert used(path) == noise.tolist()
    stated = "[weights]\nmeasurement = [0.1, 0.2, 0.3]"
    assert used(with_noise, stated) == [0.1, 0.2, 0.3]


def test_measurement_delay_is_optional_and_the_default_of_the_setting(tmp_path: Path) -> None:
    def used(path: Path, settings: str = "") -> float:
        found: float = tomllib.loads(Engine(str(path), settings).settings_toml)["measurement_delay"]
        return found

    late, part, without = (tmp_path / name for name in ("late", "part", "without"))
    write_example(without)
    assert b"measurement_delay" not in without.read_bytes()
    assert Library.load(without).measurement_delay is None
    assert used(without) == 0.0
    write_example(late, measurement_delay=0.056)
    write_library_subset(late, part, [1])
    for path in (late, part):
        assert Library.load(path).measurement_delay == 0.056
        assert used(path) == 0.056
    assert used(late, "measurement_delay = 0.0") == 0.0
    with pytest.raises(EgpError, match="measurement_delay"):
        used(late, "measurement_delay = 0.6")


def write_one(path: Path, member: MemberData) -> None:
    write_library(
        path,
        dt=0.05,
        kernel="rbf",
        vehicle="commonroad-1",
        parameters=VehicleParameters.commonroad(1),
        members=[member],
        provenance={},
    )


def test_numbers_that_are_not_finite_are_named_and_nothing_is_written(tmp_path: Path) -> None:
    path = tmp_path / "absent.safetensors"
    with pytest.raises(InvalidArgumentError, match="measurement_delay, got NaN"):
        write_example(path, measurement_delay=math.nan)
    with pytest.raises(InvalidArgumentError, match="measurement_noise, got inf"):
        write_example(path, measurement_noise=np.array([0.1, math.inf, 0.1]))
    member = MemberData(**member_arrays(0.5, 30, seed=0) | {"friction": math.nan})
    with pytest.raises(InvalidArgumentError, match="friction, got NaN"):
        write_one(path, member)
    assert not any(tmp_path.iterdir())


def test_same_content_gives_same_bytes(path: Path) -> None:
    other = path.with_name("again.safetensors")
    write_example(other)
    assert other.read_bytes() == path.read_bytes()
    assert sorted(path.parent.iterdir()) == sorted([path, other]), (
        "temporary files were left behind"
    )


def test_resealing_untouched_content_is_accepted(path: Path) -> None:
    Content(path.read_bytes()).write(path)
    assert len(Library.load(path).members) == 2


def test_a_flipped_byte_is_corruption(path: Path) -> None:
    raw = path.read_bytes()
    (length,) = struct.unpack("<Q", raw[:8])
    metadata = raw.index(b"commonroad")
    for position in (metadata, raw.index(b"0.05"), 8 + length, len(raw) // 2, len(raw) - 1):
        path.write_bytes(raw[:position] + bytes([raw[position] ^ 1]) + raw[position + 1 :])
        assert refusal(path).code == "corrupt", position


def test_a_flipped_byte_anywhere_is_refused(path: Path) -> None:
    raw = path.read_bytes()
    for position in np.random.default_rng(0).integers(0, len(raw), 150):
        path.write_bytes(raw[:position] + bytes([raw[position] ^ 16]) + raw[position + 1 :])
        refusal(path)


@pytest.mark.parametrize(
    ("code", "spoil"),
    [
        ("length", lambda raw: raw[:-1]),
        ("length", lambda raw: raw[:1000]),
        ("length", lambda raw: raw + b"\0"),
        ("length", lambda _: b"egp"),
        ("header_too_large", lambda raw: struct.pack("<Q", 100_000_000) + raw[8:]),
        ("header_too_large", lambda raw: b"\xff" * 8 + raw[8:]),
        ("malformed", lambda raw: raw[:8] + b"[" + raw[9:]),
        ("malformed", lambda _: struct.pack("<Q", 2) + b"{}"),
    ],
)
def test_spoiled_bytes(path: Path, code: str, spoil: Callable[[bytes], bytes]) -> None:
    path.write_bytes(spoil(path.read_bytes()))
    assert refusal(path).code == code


def change_metadata(**changes: object) -> Callable[[Content], None]:
    return lambda content: content.metadata.update(changes)


def change_member(**changes: object) -> Callable[[Content], None]:
    return lambda content: content.metadata["members"][0].update(changes)


def change_vehicle(**changes: object) -> Callable[[Content], None]:
    return lambda content: content.metadata["parameters"].update(changes)


def change_tensor(
    name: str, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> Callable[[Content], None]:
    def apply(content: Content) -> None:
        tensor = f"members.1.{name}"
        content.tensors[tensor] = change(content.tensors[tensor])

    return apply


def with_first(value: float) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    def apply(array: NDArray[np.float64]) -> NDArray[np.float64]:
        array.flat[0] = value
        return array

    return apply


def single_precision(content: Content) -> None:
    content.dtypes["members.1.noise"] = "F32"


def foreign_tensor(content: Content) -> None:
    content.tensors["members.2.inputs"] = np.zeros((1, 6))
    content.dtypes["members.2.inputs"] = "F64"


def swapped_units(content: Content) -> None:
    content.metadata["inputs"][3]["unit"] = "deg"


def repeated_point(content: Content) -> None:
    content.tensors["members.1.inputs"][:] = content.tensors["members.1.inputs"][0]
    content.tensors["members.1.noise"][:] = 1e-90


@pytest.mark.parametrize(
    ("code", "named", "spoil"),
    [
        ("schema_version", "3", change_metadata(schema=3)),
        ("metadata", "colour", change_metadata(colour="red")),
        ("unknown_kernel", "periodic", change_metadata(kernel="periodic")),
        ("time_step", "50", change_metadata(dt=50.0)),
        ("signals", "deg", swapped_units),
        ("count", "members", change_metadata(members=[])),
        ("count", "friction 0.5", change_member(n=10**9)),
        ("count", "friction 0.5", change_member(n=0)),
        ("vehicle", "`mass`", change_vehicle(mass=-1.0)),
        ("vehicle", "`a_min`", change_vehicle(a_min=8.0)),
        ("metadata", "length", change_vehicle(length=4.3)),
        ("metadata", "l_r", lambda content: content.metadata["parameters"].pop("l_r")),
        ("metadata", "parameters", lambda content: content.metadata.pop("parameters")),
        ("measurement_noise", "-0.1", change_metadata(measurement_noise=[0.1, -0.1, 0.1])),
        ("metadata", "length 3", change_metadata(measurement_noise=0.1)),
        ("measurement_delay", "-0.01", change_metadata(measurement_delay=-0.01)),
        ("label", "friction 1.1", change_member(label="friction 1.1")),
        ("friction", "-1", change_member(friction=-1.0)),
        (
            "missing_tensor",
            "members.1.alpha",
            lambda content: content.tensors.pop("members.1.alpha"),
        ),
        ("unexpected_tensor", "members.2.inputs", foreign_tensor),
        ("data_type", "members.1.noise", single_precision),
        ("shape", "members.0.inputs", change_member(n=29)),
        ("shape", "members.1.targets", change_tensor("targets", lambda a: a[:, :2])),
        ("shape", "members.1.alpha", change_tensor("alpha", np.transpose)),
        ("non_finite", "members.1.inputs", change_tensor("inputs", with_first(np.nan))),
        ("non_finite", "members.1.alpha", change_tensor("alpha", with_first(np.inf))),
        ("not_positive", "members.1.noise", change_tensor("noise", with_first(0.0))),
        ("not_positive", "members.1.input_std", change_tensor("input_std", with_first(-1.0))),
        ("envelope", "members.1.envelope", change_tensor("envelope", lambda a: a[::-1])),
        ("not_positive_definite", "members.1.inputs", repeated_point),
        ("alpha", "members.1.alpha", change_tensor("alpha", lambda a: a * (1.0 + 1e-8))),
        ("alpha", "members.1.alpha", change_tensor("targets", lambda a: a + 1e-6)),
        ("golden", "members.1.golden_mean", change_tensor("golden_mean", lambda a: a + 1e-8)),
        ("golden", "members.1.golden_jacobian", change_tensor("golden_jacobian", lambda a: 2 * a)),
        ("golden", "members.1.golden_variance", change_tensor("golden_variance", lambda a: 2 * a)),
        ("golden", "members.1.golden_mean", change_tensor("golden_z", lambda a: a + 1e-3)),
    ],
)
def test_spoiled_content(
    path: Path, code: str, named: str, spoil: Callable[[Content], object]
) -> None:
    content = Content(path.read_bytes())
    spoil(content)
    content.write(path)
    error = refusal(path)
    assert error.code == code, error
    assert named in str(error), "the message names what was wrong"
    assert isinstance(error, EgpError)


def test_refused_content_leaves_the_old_file(path: Path) -> None:
    before = path.read_bytes()
    arrays = member_arrays(0.5, 30, seed=0)
    arrays["alpha"][0, 0] = np.nan
    with pytest.raises(LibraryError, match=r"members\.0\.alpha"):
        write_one(path, MemberData(**arrays))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_wrong_shapes_are_refused_before_writing() -> None:
    arrays = member_arrays(0.5, 30, seed=0)
    arrays["inputs"] = arrays["inputs"][:, :5]
    with pytest.raises(EgpError, match=r"inputs of shape \(n, 6\), got \(30, 5\)"):
        MemberData(**arrays)


def test_a_member_has_one_vehicle() -> None:
    arrays = member_arrays(0.5, 30, seed=0)
    with pytest.raises(EgpError, match="one vehicle"):
        MemberData(**arrays, single_track=np.ones(17), kinematic=np.ones(3))
    with pytest.raises(EgpError, match="kinematic"):
        MemberData(**arrays, kinematic=np.ones(4))


def test_missing_file_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere"):
        Library.load(tmp_path / "nowhere.safetensors")


def test_unknown_member_is_an_index_error(path: Path) -> None:
    with pytest.raises(IndexError, match="member 2 of a library of 2"):
        Library.load(path).predict(np.zeros((1, 6)), 2)
