"""`egp simulate`."""

import typer


def simulate(context: typer.Context) -> None:
    """Simulate vehicles, replicas, routers and network with faults from a seed.

    --seed N replays one seed with its trace, --seeds A..B runs many seeds,
    --planted shows which oracle finds each planted fault, --vehicles,
    --replicas, --routers and --seconds set the size; `egp simulate -- --help`
    lists all options. The libraries are those of the demo and the evaluation.

    For example:
      egp simulate --seeds 0..100
      egp simulate --seed 7
    """
    from functools import partial

    from egp_service import shipped
    from egp_service._core import run_simulation
    from egp_service.cli.programs import run_program

    program = partial(run_simulation, shipped.DEMO_LIBRARY, shipped.EVALUATION_LIBRARY)
    raise typer.Exit(run_program(program, context.args))
