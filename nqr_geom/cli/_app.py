"""The application that commands register with, where it prints, and its entry point."""

from __future__ import annotations

from collections.abc import Sequence

from cyclopts import App, CycloptsError
from rich.console import Console

import nqr_geom as ng

__all__ = ["app", "error_console", "main", "out_console"]

app = App(
    name="nqr-geom",
    version=ng.__version__,
    help="Winding numbers, distances, harmonic functions and light of what you bring, and what accuracy costs in time.",
    result_action="return_value",
)
out_console = Console(markup=False)
error_console = Console(stderr=True, markup=False)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line: exit code 2 and one clear line for bad input, else what the command says, 0 if nothing."""
    try:
        code = app(arguments, exit_on_error=False, print_error=True)
    except CycloptsError:
        return 2
    except (ValueError, TypeError, ImportError, OSError, RuntimeError) as error:
        error_console.print(f"error: {error}", style="red", highlight=False, soft_wrap=True)
        return 2
    return code if isinstance(code, int) else 0
