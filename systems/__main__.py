"""The command line: `python -m systems` lists the systems, `python -m systems NAME --output DIR` runs one."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from systems.scene import OutputError, checkpoint_of, fresh_folder, is_interrupted, what_goes_on

SYSTEMS = {
    "mass_spring": "masses on a stretched chain of springs, every line of their transverse motion",
    "guitar_string": "a guitar string of 200 beads, plucked hard and gently, against the stiff and the discrete string",
    "xylophone_bar": "a bar under tension and as played, against Euler and Bernoulli",
    "weighted_string": "the guitar string with beads 40 times heavier, against the exact modes of the loaded chain",
    "open_ring": "an open ring pulled apart in its plane and across it, its energies and its deflections",
    "planar_force_extension": "a random planar chain pulled cold and hot: is missing noise why no worm-like chain fits?",
    "helix_force_extension": "a helix pulled without temperature, its torsion from soft to stiff; a warm one unloaded",
    "dna_force_extension": "double-stranded DNA pulled from 0.05 to 50 pN, against the worm-like chain",
    "pseudoknot": "two helices screwed into each other, left alone and pulled apart: works, forces, what makes them hold",
    "stability": "what breaks a run, from straight to folded back, 1e-10 m to 1 m, 0 to 1e6 K: right, refused or wrong",
    "error_vs_runtime": "every system's error against its run time, what is cheapest, and what growth costs",
}


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """The first SIGTERM ends a run as Ctrl-C does; more of them, as some tools send, do not disturb that."""

    def interrupt(*_: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; 0 if every exact check passed, 1 if one failed, 2 for bad arguments, 130 after Ctrl-C or SIGTERM.

    A file that cannot be written, and a worker that was killed, are 2 as well.
    """
    given = sys.argv[1:] if arguments is None else arguments
    name = next((a for a in given if not a.startswith("-")), None)
    parser = argparse.ArgumentParser(
        prog="python -m systems", description="Run a system of elastic filaments.", allow_abbrev=False
    )
    parser.add_argument("name", nargs="?", help="the system; without one they are listed")
    parser.add_argument("--output", type=Path, help="folder for the results: new, or empty")
    parser.add_argument("--overwrite", action="store_true", help="replace results in the folder by complete new ones")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="the same checks with larger error bars, in some 20 s; two minutes for reports",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the noise (default 1)")
    system = import_module(f"systems.{name}") if name in SYSTEMS else None
    if system is not None:
        system.options(parser.add_argument_group(f"options of {name}"))
    known, _ = parser.parse_known_args(given)
    if known.name is None:
        parser.parse_args(given)
        for entry, what in SYSTEMS.items():
            print(f"{entry:24s} {what}")
        return 0
    if system is None or known.name != name:
        parser.error(f"Argument `name` must be one of {', '.join(SYSTEMS)}, but is {known.name}.")
    options = parser.parse_args(given)
    if options.output is None:
        parser.error("Argument `--output` must name a folder for the results, but is missing.")
    output = options.output.absolute()
    replace = options.overwrite or (getattr(options, "resume", False) and is_interrupted(output))
    try:
        with _terminated_as_interrupted(), fresh_folder(output, overwrite=replace) as draft:
            code: int = system.run(draft.folder, quick=options.quick, seed=options.seed, options=options)
            place = draft.settle(complete=code == 0)
            if code != 130 and hasattr(options, "resume"):
                checkpoint_of(output).unlink(missing_ok=True)
    except OutputError as error:
        parser.error(str(error))
    except (ValueError, TypeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: {error.strerror or error}", file=sys.stderr)
        return 2
    except BrokenExecutor as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        kept = hasattr(options, "resume") and checkpoint_of(output).exists()
        told = what_goes_on(checkpoint_of(output)) if kept else "nothing is kept of this run"
        print(f"interrupted: {told}", file=sys.stderr)
        return 130
    print(f"Results in {place}")
    return code


if __name__ == "__main__":
    sys.exit(main())
