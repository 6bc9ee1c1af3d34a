"""`egp replay`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from egp_service.cli.options import Recording, check_unused, check_writable, recording_file

if TYPE_CHECKING:
    from collections.abc import Mapping

    from egp_service.control.recorded import Recorded

DIFFERENT = 4


def replay(
    recording: Recording,
    library: Annotated[
        Path | None, typer.Option("--library", "-l", help="Library in place of the recorded one.")
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(help="TOML file of settings in place of the recorded ones (egp settings)."),
    ] = None,
    *,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Picture; by default RECORDING-replay-CHANGE.png."),
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Draw a picture of differences.")] = True,
) -> None:
    """Repeat every recorded control step, and compare it bit for bit.

    With --library or --settings, show instead what would have differed,
    where it first matters (1 % of an actuator's range), and a picture.
    Each step begins from what was recorded before it, so that
    differences are those of single steps and do not add up.

    The exit code is 4 if replies differ although nothing was changed:
    another version of egp-service, or other vector instructions.

    For example:
      egp replay runs/20260101-120000-random/run.mcap
      egp replay run.mcap --library candidate.safetensors
      egp replay run.mcap --settings softer.toml
    where softer.toml holds, for instance:
      cost.lateral = 20.0
    """
    from egp_service.cli import replay_text
    from egp_service.cli.progress import counted
    from egp_service.control.recorded import read_recording
    from egp_service.control.replay import replay as compute

    if not pictures:
        reason = "names a picture, which --no-pictures leaves out: give one of them"
        check_unused({"--output": output}, reason)
    recording = recording_file(recording)
    target = output or _default_picture(recording, library, settings)
    changed = settings is not None or library is not None
    # Without a change nothing should differ, so that a recording may lie where nothing is written.
    if pictures and (changed or output is not None):
        _check_picture(target, recording)
    console = Console(soft_wrap=True, markup=False)
    recorded = read_recording(recording)
    console.print(replay_text.heading(recording, recorded))
    file = _library(recorded, library)
    used = _settings(recorded, settings, other_library=library is not None)
    with counted(console, "replaying", "steps") as report:
        result = compute(recorded, file, used, report)
    for line in replay_text.outcome(recorded, result, used, changed=changed):
        console.print(line)
    if result.first_different is None:
        if output is not None:
            console.print("No picture: nothing differs.")
        return
    if pictures:
        given = {"library": library, "settings": settings}
        words = [f"{name} {file.name}" for name, file in given.items() if file is not None]
        with console.status("Drawing ..."):
            from egp_service.simulation.replay_report import draw_replay

            draw_replay(result, ", ".join(words) or "this version on this machine", target)
        console.print(f"Picture: {target}")
    if not changed:
        raise typer.Exit(DIFFERENT)


def _default_picture(recording: Path, library: Path | None, settings: Path | None) -> Path:
    """Name the picture by what is changed, so that another change has another picture."""
    changes = [file.stem for file in (library, settings) if file is not None]
    return recording.with_name("-".join([recording.stem, "replay", *changes]) + ".png")


def _check_picture(output: Path, recording: Path) -> None:
    """Errors unless a picture can be drawn and may have this name; this makes no folder.

    It is checked before the time that the replay takes.
    """
    from egp_service._core import EgpError
    from egp_service.simulation.report import PICTURES, check_picture

    check_picture(output)
    folder = output.parent
    while not folder.exists():
        folder = folder.parent
    check_writable(folder / output.name)
    if output.name in PICTURES and output.resolve().parent == recording.resolve().parent:
        raise EgpError(f"{output} is a picture of the recorded run: choose another --output")


def _library(recorded: "Recorded", given: Path | None) -> Path:
    """Give the library to replay with; without one given, it must be the recorded one."""
    from hashlib import sha256

    from egp_service import shipped
    from egp_service.control.recorded import RecordingError

    if given is not None:
        return given
    named = recorded.about.get("library_file")
    for file in (*([Path(named)] if named else []), shipped.DEMO_LIBRARY):
        if file.is_file() and sha256(file.read_bytes()).hexdigest() == recorded.about["library"]:
            return file
    raise RecordingError(
        f"the recorded library {recorded.about['library'][:12]}… is not "
        f"{f'at {named} any more' if named else 'known here, because a service had it'}: give it, "
        "or another one, with --library"
    )


def _settings(
    recorded: "Recorded", file: Path | None, *, other_library: bool
) -> "Mapping[str, object]":
    """Give the settings to replay with: the recorded ones, and over them those of the file.

    With another library, what was not stated comes from that library.
    """
    from egp_service.cli.settings_file import read_settings

    base = recorded.stated_settings if other_library else recorded.settings or {}
    return base if file is None else _over(base, read_settings(file))


def _over(base: "Mapping[str, object]", other: "Mapping[str, object]") -> dict[str, object]:
    merged = dict(base)
    for key, value in other.items():
        below = merged.get(key)
        # A prior is stated as a whole: the strengths of its two kinds have other names.
        nested = isinstance(value, dict) and isinstance(below, dict) and key != "prior"
        merged[key] = _over(below, value) if nested else value  # type: ignore[arg-type]
    return merged
