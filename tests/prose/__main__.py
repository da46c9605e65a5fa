"""Print each page's mean and its long sentences; ``--write`` notes what has become better.

python -m tests.prose [PAGE …] [--write]
"""

import sys

from tests.prose.ratchet import kept, lowered, write
from tests.prose.sources import pages

wanted = [word for word in sys.argv[1:] if not word.startswith("-")]
found = pages()
for name, page in found.items():
    if wanted and not any(word in name for word in wanted):
        continue
    print(f"{name}: {page.sentences} sentences, mean {page.mean:.1f} words, {len(page.long)} too long")
    for sentence in page.long if wanted else ():
        print(f"  {sentence}")
if "--write" in sys.argv[1:]:
    write(lowered(kept(), found))
