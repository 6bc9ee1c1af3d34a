"""`egp settings`."""

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.table import Table

    from egp_service.cli.settings_text import Setting


def settings(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            help="Show only settings whose section, key or meaning has all these words.",
            show_default=False,
        ),
    ] = None,
    *,
    number: Annotated[
        int | None,
        typer.Option("--section", metavar="N", help="Show only the section of this number."),
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
      egp settings --section 7
    """
    from itertools import groupby

    from rich.console import Console

    from egp_service._core import EgpError
    from egp_service.cli.settings_text import read_settings_document

    listed = list(read_settings_document())
    titles = {setting.number: setting.section for setting in listed}
    if number is not None and number not in titles:
        raise EgpError(f"no section {number}: sections are 1 to {max(titles)}")
    wanted = [word.lower() for word in words or []]
    found = [
        setting
        for setting in listed
        if number in (None, setting.number)
        and all(
            word in f"{setting.section} {setting.group} {setting.key} {setting.meaning}".lower()
            for word in wanted
        )
    ]
    if not found:
        raise EgpError(f"no setting has {' '.join(wanted)!r}: `egp settings` lists all")
    console = Console()
    for section, own in groupby(found, lambda setting: setting.number):
        console.print(_table(f"{section}. {titles[section]}", list(own)))
    for line in _references(found, titles):
        console.print(line, highlight=False)


def _table(title: str, rows: "Sequence[Setting]") -> "Table":
    from rich import box
    from rich.markup import escape

    from egp_service.cli.narrow_table import NarrowTable

    table = NarrowTable(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("key", no_wrap=True)
    table.add_column("default", overflow="fold", max_width=20)
    table.add_column("unit", max_width=12)
    table.add_column("meaning", ratio=1, overflow="fold")
    for setting in rows:
        cells = (setting.key, setting.default, setting.unit, setting.meaning)
        table.add_row(*map(escape, cells))
    return table


def _references(shown: "Sequence[Setting]", titles: dict[int, str]) -> list[str]:
    """Say where to find the sections and documents that the settings refer to."""
    import re

    text = " ".join(setting.meaning for setting in shown)
    named = {int(number) for number in re.findall(r"(?<!md, )section (\d+)", text)}
    lines = [
        f"Section {number} is {titles[number]!r}: `egp settings --section {number}` shows it."
        for number in sorted(named - {setting.number for setting in shown})
    ]
    if "docs/" in text:
        lines.append("The folder docs is that of the source.")
    return lines
