"""Print each page's mean and its long sentences; ``--write`` notes what has become better, ``--draw`` prints a sample.

python -m tests.prose [PAGE …] [--write]
python -m tests.prose --draw N [--seed S]
"""

import argparse

from tests.prose.draw import draw
from tests.prose.ratchet import kept, lowered, write
from tests.prose.sources import pages

parser = argparse.ArgumentParser(prog="python -m tests.prose")
parser.add_argument(
    "pages", nargs="*", metavar="PAGE", help="part of a page's name: its long sentences are printed"
)
parser.add_argument("--write", action="store_true", help="update the list of pages that are not done")
parser.add_argument(
    "--draw", type=int, metavar="N", help="print N random sentences and N/2 docstrings instead"
)
parser.add_argument("--seed", type=int, default=1)
given = parser.parse_args()
if given.draw:
    print("\n".join(draw(given.draw, given.seed)))
    raise SystemExit
found = pages()
for name, page in found.items():
    if given.pages and not any(word in name for word in given.pages):
        continue
    print(f"{name}: {page.sentences} sentences, mean {page.mean:.1f} words, {len(page.long)} too long")
    for sentence in page.long if given.pages else ():
        print(f"  {sentence}")
if given.write:
    write(lowered(kept(), found))
