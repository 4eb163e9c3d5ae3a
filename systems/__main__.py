"""The command line: `python -m systems` lists the systems, `python -m systems NAME --output DIR` runs one."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path

from systems.scene import OutputError, fresh_folder

SYSTEMS = {"dna_force_extension": "double-stranded DNA pulled from 0.05 to 50 pN, against the worm-like chain"}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; 0 if every exact check passed, 1 if one failed, 2 for bad arguments, 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(prog="python -m systems", description="Run a system of elastic filaments.")
    parser.add_argument("name", nargs="?", help="the system; without one they are listed")
    parser.add_argument("--output", type=Path, help="folder for the results: new, or empty")
    parser.add_argument(
        "--overwrite", action="store_true", help="replace results in the folder when the new ones are complete"
    )
    parser.add_argument("--quick", action="store_true", help="the same checks with larger error bars, in under 20 s")
    parser.add_argument("--seed", type=int, default=1, help="of the noise (default 1)")
    known, rest = parser.parse_known_args(arguments)
    if known.name is None:
        for name, what in SYSTEMS.items():
            print(f"{name:24s} {what}")
        return 0
    if known.name not in SYSTEMS:
        parser.error(f"Argument `name` must be one of {', '.join(SYSTEMS)}, but is {known.name}.")
    if known.output is None:
        parser.error("Argument `--output` must name a folder for the results, but is missing.")
    system = import_module(f"systems.{known.name}")
    more = system.options(argparse.ArgumentParser(prog=f"python -m systems {known.name}")).parse_args(rest)
    try:
        with fresh_folder(known.output.absolute(), overwrite=known.overwrite) as folder:
            code: int = system.run(folder, quick=known.quick, seed=known.seed, options=more)
    except OutputError as error:
        parser.error(str(error))
    except (ValueError, TypeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"Results in {known.output}")
    return code


if __name__ == "__main__":
    sys.exit(main())
