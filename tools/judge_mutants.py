"""Say what became of mutants: mutmut results --all true | python -m tools.judge_mutants PATTERN...

Exits with 1 if more than one in ten of those that were tried went unnoticed.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from fnmatch import fnmatch

UNNOTICED = ("survived", "no tests")
MOST_UNNOTICED = 0.1


def judge(results: Iterable[str], patterns: Sequence[str]) -> str | None:
    """Print what went unnoticed, and totals; return what is wrong with that, in a sentence."""
    fates = dict(line.strip().rsplit(": ", 1) for line in results)
    tried = {name: fate for name, fate in fates.items() if any(fnmatch(name, pattern) for pattern in patterns)}
    unnoticed = {name: fate for name, fate in tried.items() if fate in UNNOTICED}
    for name, fate in unnoticed.items():
        print(f"{fate}: {name}")
    totals = ", ".join(f"{count} {fate}" for fate, count in Counter(tried.values()).most_common())
    print(f"{len(tried)} mutants: {totals}; .venv/bin/mutmut show NAME shows one")
    if len(unnoticed) > MOST_UNNOTICED * len(tried):
        return f"{len(unnoticed)} of {len(tried)} changes, over one in ten, went unnoticed: add tests that notice them"
    return None


if __name__ == "__main__":
    sys.exit(judge(sys.stdin, sys.argv[1:]))
