"""The command line of the suite."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import gate, tables
from benchmarks.registry import SUITE, Context, Row
from benchmarks.run import child, load_suite, run

DESCRIPTION = """\
Measure OptI-ProMP beside its peers, in one run on this machine.

A metric is called family/subject/quantity, and belongs to a benchmark. Each benchmark runs in a
process of its own with one thread. What is not installed, fails or takes too long is a row with
the reason. Times differ by machine and are only recorded; ratios (unit ×: ours by a peer, or by a
fixed piece of work, in the same run) are what the gate compares.
"""
EXAMPLES = """\
examples:
  python -m benchmarks --list                     every metric with unit, direction, tolerance
  python -m benchmarks --only evaluation          cost and gradient beside C++
  python -m benchmarks --only 'planners/*/ompl*'  by pattern
  python -m benchmarks --out results.json --markdown tables.md
  python -m benchmarks --gate                     exit 1 where a ratio is worse than the baseline
  python -m benchmarks --update-baseline          accept this run's ratios as the baseline

peers:   pip install -c constraints.txt 'torch==2.13.0' -e packages/optipromp-bench'[peers]'
         (torch: a CPU build)
exit:    0 done; 1 the gate found a regression; 2 wrong arguments
"""


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    out = argparse.ArgumentParser(
        prog="python -m benchmarks", description=DESCRIPTION, epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = out.add_argument
    add("--only", metavar="NAME", nargs="+", action="extend", default=[],
        help="benchmarks or metrics, by pattern; may be stated again")  # fmt: skip
    add("--list", action="store_true", help="list benchmarks and metrics, measure nothing")
    add("--quick", action="store_true", help="a tenth of the repeats, to try it out")
    add("--out", metavar="FILE", type=Path, help="write the results as JSON")
    add("--markdown", metavar="FILE", type=Path, help="write the tables")
    add(
        "--gate",
        action="store_true",
        help="compare ratios with the baseline; measure a regression twice",
    )
    add("--update-baseline", action="store_true", help="accept this run's ratios as the baseline")
    add("--baseline", metavar="FILE", type=Path, default=gate.BASELINE, help="default: %(default)s")
    add("--quiet", action="store_true", help="no progress on standard error")
    add("--child", metavar="NAME", help=argparse.SUPPRESS)
    return out


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = parser().parse_args(arguments)

    def say(word: str) -> None:
        if not options.quiet:
            print(word, file=sys.stderr, flush=True)

    load_suite()
    if options.child:
        child(options.child, options.quick, options.out, say)
        return 0
    try:
        selected = SUITE.select(options.only)
        if options.list:
            print(tables.listing(selected))
            return 0
        baseline = gate.load(options.baseline) if options.gate else {}
        results = run(selected, Context(options.quick, say))
        if options.gate:
            results = again(results, baseline, Context(options.quick, say))
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    rows = [Row.from_dict(row) for row in results["rows"]]
    if options.out:
        options.out.write_text(
            json.dumps(results, indent=2, ensure_ascii=False) + "\n", encoding="utf-8"
        )
    if options.markdown:
        options.markdown.write_text(tables.markdown(results), encoding="utf-8")
    print(tables.text(rows))
    if options.update_baseline:
        about = {key: results[key] for key in ("date", "commit", "machine", "versions")}
        count = gate.update(rows, about, options.baseline)
        say(f"{count} ratios written to {options.baseline}")
    return _gate(rows, baseline) if options.gate else 0


def again(results: dict[str, Any], baseline: dict[str, float], context: Context) -> dict[str, Any]:
    """Measure once more what looks like a regression: one that other work made does not repeat."""
    rows = {row["name"]: row for row in results["rows"]}
    worse = gate.regressions(map(Row.from_dict, rows.values()), baseline)
    if not worse:
        return results
    context.say(f"measuring again: {', '.join(worse)}")
    second = run(SUITE.select(worse), context)["rows"]
    kept = set(gate.regressions(map(Row.from_dict, second), baseline))
    rows |= {row["name"]: row for row in second if row["name"] not in kept}
    return results | {"rows": list(rows.values())}


def _gate(rows: Sequence[Row], baseline: dict[str, float]) -> int:
    found = gate.compare(rows, baseline)
    for comparison in found:
        print(f"{comparison.verdict:<13}{comparison.name}: {comparison.message}", file=sys.stderr)
    worse = [c.name for c in found if c.verdict == "regression"]
    if worse:
        print(f"gate: {len(worse)} regressions: {', '.join(worse)}", file=sys.stderr)
        return 1
    compared = sum(c.verdict in ("same", "better") for c in found)
    print(f"gate: no regression among {compared} ratios", file=sys.stderr)
    return 0
