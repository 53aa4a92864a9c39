"""The menu of the benchmarks, and what runs them.

python -m benchmarks                          # the menu
python -m benchmarks NAME [NAME ...]          # some of them; options such as --assets DIR come after the names
python -m benchmarks NAME --help              # the options of one
python -m benchmarks --all ASSETS_DIR         # all whose inputs are given; more with --meshes, --data, --finer
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence

import tyro

from benchmarks.catalogue import BY_NAME, CATALOGUE, Benchmark, menu
from benchmarks.inputs import Inputs

USAGE = "\n".join((__doc__ or "").splitlines()[2:])


def main(arguments: Sequence[str]) -> int:
    """Run what ``arguments`` ask for; returns the exit status."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(f"{menu()}\n{USAGE}")
        return 0
    if arguments[0] == "--all":
        if len(arguments) < 2 or arguments[1].startswith("-"):
            return _refuse("--all needs the folder of assets: python -m benchmarks --all ASSETS_DIR")
        return run_all(["--assets", *arguments[1:]])
    count = next((i for i, word in enumerate(arguments) if word.startswith("-")), len(arguments))
    names, options = arguments[:count], arguments[count:]
    if unknown := [name for name in names if name not in BY_NAME]:
        return _refuse(f"there is no benchmark {', '.join(unknown)}; `python -m benchmarks` prints the menu")
    # All are parsed before the first runs, so that a mistake in an option costs no hour
    for run in [bound(BY_NAME[name], options) for name in names]:
        run()
    return 0


def run_all(options: Sequence[str]) -> int:
    """Run every benchmark whose inputs ``options`` give, and say which were left out."""
    inputs = tyro.cli(Inputs, args=options, prog="python -m benchmarks --all", description=USAGE)
    for benchmark in CATALOGUE:
        missing = [f"--{name}" for name in benchmark.needs if inputs.given(name) is None]
        if missing:
            print(f"{benchmark.name}: left out, it needs {' and '.join(missing)}")
        else:
            print(f"{benchmark.name}: about {benchmark.minutes} minutes", flush=True)
            benchmark.main()(inputs)
    return 0


def bound(benchmark: Benchmark, options: Sequence[str]) -> Callable[[], None]:
    """The benchmark with its options, which are those of its entry function. Raises :class:`SystemExit`."""
    function = benchmark.main()

    @functools.wraps(function)
    def bind(inputs: Inputs, **further: object) -> Callable[[], None]:
        for name in benchmark.needs:
            inputs.require(name)
        return functools.partial(function, inputs, **further)

    return tyro.cli(
        bind, args=options, prog=f"python -m benchmarks {benchmark.name}", config=(tyro.conf.OmitArgPrefixes,)
    )


def _refuse(sentence: str) -> int:
    print(f"error: {sentence}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
