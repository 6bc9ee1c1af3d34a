"""`egp load`."""

import typer

PASS_ON = {"allow_extra_args": True, "ignore_unknown_options": True}


def load(context: typer.Context) -> None:
    """Load a running service with simulated vehicles, and report answer times.

    All options are those of the program egp-load: --connect ENDPOINT (by
    default tcp/127.0.0.1:7447), --vehicles 4, --seconds 20, --json FILE and
    more; `egp load -- --help` lists them. The program is built from the
    source by `cargo build --release -p egp-load`.

    Look at `generator lag` first: if it is far above a millisecond, the other
    times describe this machine instead of the service.

    For example:
      egp serve library.safetensors &
      egp load --vehicles 8 --seconds 20
    """
    import shutil
    import subprocess
    from pathlib import Path

    from egp_service._core import EgpError

    built = Path("target/release/egp-load")
    program = shutil.which("egp-load") or (str(built) if built.is_file() else None)
    if program is None:
        raise EgpError(
            "the program egp-load is neither on the PATH nor at target/release/egp-load: build it "
            "in the source folder with `cargo build --release -p egp-load`"
        )
    raise typer.Exit(subprocess.run([program, *context.args], check=False).returncode)
