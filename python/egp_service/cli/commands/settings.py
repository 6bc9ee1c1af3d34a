"""`egp settings`."""

from typing import Annotated

import typer


def settings(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            help="Show only settings whose section, key or meaning has all these words.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """List every setting with its default, unit and meaning.

    The text is that of docs/settings.md, which also says where each default
    comes from. Settings of the control step go into a TOML file for
    `egp serve --settings` and `egp replay --settings`, or into the table
    `settings` of a service and the table `control` of a scenario.

    For example:
      egp settings
      egp settings cost
      egp settings scenario speed
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from egp_service._core import EgpError
    from egp_service.cli.settings_text import read_settings_document

    wanted = [word.lower() for word in words or []]
    found = [
        setting
        for setting in read_settings_document()
        if all(
            word in f"{setting.section} {setting.group} {setting.key} {setting.meaning}".lower()
            for word in wanted
        )
    ]
    if not found:
        raise EgpError(f"no setting has {' '.join(wanted)!r}: `egp settings` lists all")
    console = Console()
    table, section = Table(), ""
    for setting in found:
        if setting.section != section:
            if section:
                console.print(table)
            section = setting.section
            table = Table(title=section, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1))
            table.add_column("key", no_wrap=True)
            table.add_column("default", overflow="fold", max_width=20)
            table.add_column("unit", max_width=12)
            table.add_column("meaning", ratio=1, overflow="fold")
        # The texts have brackets that are no markup.
        table.add_row(
            *(
                cell.replace("[", r"\[")
                for cell in (setting.key, setting.default, setting.unit, setting.meaning)
            )
        )
    console.print(table)
