"""Commands for those who set the library up: `doctor`, `completion`."""

from __future__ import annotations

import json
from typing import Annotated, Literal

from cyclopts import Parameter
from rich import box
from rich.table import Table

from nqr_geom.cli._app import app, error_console, out_console

__all__ = ["completion", "doctor"]

app.register_install_completion_command(help="Install completion for your shell and exit.")


@app.command
def doctor(
    *,
    json_: Annotated[bool, Parameter(name="--json", help="Print findings as JSON.", negative="")] = False,
) -> int:
    """Look over this installation: exit code 0 if it is sound, 1 with one line a problem if it is not."""
    from nqr_geom.doctor import examine

    findings = examine()
    problems = [finding.problem for finding in findings if finding.problem]
    if json_:
        sections: dict[str, dict[str, str]] = {}
        for finding in findings:
            sections.setdefault(finding.section, {})[finding.name] = finding.told
        print(json.dumps({"healthy": not problems, "problems": problems, **sections}, indent=1))
        return 1 if problems else 0
    table = Table(box=box.SIMPLE_HEAD, show_header=False)
    for overflow in ("ellipsis", "ellipsis", "fold"):  # paths are long, and wanted in full
        table.add_column(overflow=overflow)
    seen = ""
    for finding in findings:
        if finding.section != seen and seen:
            table.add_section()
        table.add_row(finding.section if finding.section != seen else "", finding.name, finding.told)
        seen = finding.section
    out_console.print(table)
    for problem in problems:
        error_console.print(f"problem: {problem}", style="red", highlight=False, soft_wrap=True)
    if not problems:
        out_console.print("no problems found")
    return 1 if problems else 0


@app.command
def completion(shell: Annotated[Literal["bash", "zsh", "fish", "powershell"], Parameter(help="Which shell.")]) -> None:
    """Print the completion script for a shell; `nqr-geom --install-completion` installs it."""
    print(app.generate_completion(shell=shell))
