"""The evaluation report as one self-contained HTML file."""

from __future__ import annotations

import base64
import html
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from egp_service.evaluation.claim import Claim
    from egp_service.evaluation.statistics import Group, Interval

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1f2937; max-width: 76rem; margin: 2rem auto;
       padding: 0 .5rem; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 2.5rem; }
table { border-collapse: collapse; margin: 1rem 0; font-size: 12.5px;
        font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: .2rem .5rem; border-bottom: 1px solid #e5e7eb; }
table.numbers { font-size: 10px; } table.numbers td { white-space: nowrap; }
table.numbers th, table.numbers td { padding: .2rem .25rem; }
th:first-child, td:first-child, .text { text-align: left; }
th { font-weight: 600; color: #5a606b; } img { max-width: 100%; } code { background: #f3f4f6; }
.no { color: #c2410c; font-weight: 600; } .yes { color: #3f6f3a; font-weight: 600; }
.none { color: #5a606b; } nav li { margin: 0; }
p.note { color: #5a606b; }
"""


@dataclass(frozen=True, slots=True)
class Section:
    """A section: text, figures and tables."""

    title: str
    text: str
    figures: tuple[Path, ...] = ()
    tables: tuple[str, ...] = ()


def page(title: str, introduction: str, sections: Sequence[Section]) -> str:
    """Return the page with a list of contents and embedded pictures."""
    titles = [html.escape(section.title) for section in sections]
    contents = "".join(
        f'<li><a href="#section-{number}">{name}</a></li>' for number, name in enumerate(titles)
    )
    body = [f"<h1>{html.escape(title)}</h1>", f"<p>{introduction}</p>"]
    body.append(f"<nav><ol>{contents}</ol></nav>")
    for number, section in enumerate(sections):
        body += [f'<h2 id="section-{number}">{titles[number]}</h2>', f"<p>{section.text}</p>"]
        body += [_picture(path) for path in section.figures]
        body += section.tables
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style><body>{''.join(body)}</body></html>\n"
    )


def claim_table(claims: Iterable[Claim]) -> str:
    """Return a table with a row for each claim: whether it holds, and the evidence."""
    verdicts = {True: ("yes", "holds"), False: ("no", "fails"), None: ("none", "no data")}
    rows = [
        f"<tr><td class=text>{html.escape(c.text)}</td><td class={{}}>{{}}</td>".format(
            *verdicts[c.holds]
        )
        + f"<td class=text>{html.escape(c.evidence)}</td></tr>"
        for c in claims
    ]
    heads = "<tr><th>claim</th><th></th><th class=text>evidence</th></tr>"
    return f"<table>{heads}{''.join(rows)}</table>"


def group_table(groups: Iterable[Group]) -> str:
    """Return a table with a row for each contender and condition."""
    heads = (
        "contender", "condition", "completed", "lateral RMS, m", "lateral max, m",
        "speed RMS, m/s", "time, s", "off track, s", "settling, s", "RMS / oracle's",
        "time / oracle's", "no plan", "late", "step, ms",
    )  # fmt: skip
    rows = [
        "<tr>"
        + "".join(
            f"<td class=text>{html.escape(text)}</td>"
            for text in (group.contender, group.condition)
        )
        + f"<td class={'yes' if group.completed == group.runs else 'no'}>"
        f"{group.completed}/{group.runs} ({group.share.low:.2f}-{group.share.high:.2f})</td>"
        + "".join(
            f"<td>{text}</td>"
            for text in (
                interval(group.lateral_rms, 4),
                interval(group.lateral_max, 2),
                interval(group.speed_rms, 2),
                interval(group.time, 2),
                interval(group.off_track, 2),
                interval(group.settling, 2),
                interval(group.regret, 2),
                interval(group.time_regret),
                str(group.misses),
                str(group.late),
                f"{group.step_ms:.2f}",
            )
        )
        + "</tr>"
        for group in groups
    ]
    texts, numbers = heads[:2], heads[2:]
    header = "".join(f"<th class=text>{head}</th>" for head in texts)
    header += "".join(f"<th>{head}</th>" for head in numbers)
    return f"<table class=numbers><tr>{header}</tr>{''.join(rows)}</table>"


def plain_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of texts."""
    header = "".join(f"<th>{html.escape(head)}</th>" for head in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table class=numbers><tr>{header}</tr>{body}</table>"


def interval(found: Interval, digits: int = 3) -> str:
    """Format a value and its interval; a value that no run has is "no data"."""
    if math.isnan(found.value):
        return "no data"
    return found.text(f".{digits}f")


def _picture(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img alt="{html.escape(path.stem)}" src="data:image/png;base64,{data}">'
