"""No sentence over 25 words, and a mean below 18 on each page: measured, and held."""

import ast

import pytest

from tests.prose import ratchet, sources
from tests.prose.ratchet import Most
from tests.prose.sentences import MEAN, SPAN, measure, split, words


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("It holds. It ends.", 2),
        ("The gap is 0.05 m/s in version 0.1.0 of s2r.", 1),
        ("Units, e.g. metres, i.e. lengths, vs. Breach et al. 2017, are converted.", 1),
        ("P. Akella, W. Ubellacker and A. D. Ames wrote it. It is good.", 2),
        ("The rows hold, each under its own B. The ladder is larger.", 2),
        ("Columns q_0 … q_11 are one vector. s2r reads them.", 2),
        ("Is it safe? No! (Not yet.) Wait.", 4),
        ('It says "stop." Then it stops.', 2),
        ("The rest follows:", 1),
        ("", 0),
    ],
)
def test_sentences_are_split(text, count):
    assert len(split(text)) == count


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("No rollout is lost.", 4),
        ("If P(ρ < r) ≤ p at every test", 5),
        ("worst − best = 0.3 m/s", 2),
        (f"Run {SPAN} again – at once.", 5),
        ("a well-known 1,318 rollouts", 4),
        ("— … –", 0),
    ],
)
def test_words_are_counted(text, count):
    assert words(text) == count


def test_a_page_is_read_without_its_code():
    page = sources.markdown(
        "---\ntitle: not this\n---\n# A head\n\nSome `code here` and\n[a link](to.md), $x + y$ too.\n\n"
        "<!-- not this -->\n```sh\nnot this\n```\n\n| head | |\n| --- | --- |\n| a cell | `x` |\n\n"
        "- an item\n- {doc}`x` too\n"
    )
    assert page.paragraphs == [f"Some {SPAN} and a link, {SPAN} too.", "an item", f"{SPAN} too"]
    assert page.fragments == ["A head", "head", "", "a cell", SPAN]


def test_messages_are_strings_with_their_fields_and_no_docstrings():
    tree = ast.parse(
        'def f(x):\n    """Not this one, it is a docstring."""\n'
        '    raise E(f"there is no file {x} in the folder; " "make one" + x.y)\n    g("key", "a b")\n'
    )
    assert [text for _, text in sources.literals(tree)] == [
        f"there is no file {SPAN} in the folder; make one{SPAN}"
    ]
    assert list(sources.docstrings(tree)) == ["Not this one, it is a docstring."]


def test_a_long_sentence_and_a_high_mean_are_noticed():
    good = measure(["It is short. This one is short, too."], ["a cell"])
    assert good.done
    assert good.mean == 4.0
    assert not measure([], ["word " * 26]).done
    assert not measure(["word " * 20]).done
    found = {"a": good, "b": measure(["word " * 26]), "c": measure(["word " * 20])}
    assert [line.partition(":")[0] for line in ratchet.worse({}, found)] == ["b", "c"]
    assert not ratchet.worse({"b": Most(26, 1), "c": Most(20, 0)}, found)
    assert ratchet.lowered({"a": Most(30, 3), "b": Most(30, 3), "gone": Most(30, 3)}, found) == {
        "b": Most(26, 1)
    }


def test_no_page_has_become_worse(capsys):
    """A page that is not listed has a mean below 18 and no sentence over 25 words."""
    found = sources.pages()
    with capsys.disabled():
        print()
        for name, page in found.items():
            print(f"{name}: mean {page.mean:.1f}, {len(page.long)} over 25")
    assert len(found) > 40
    assert not (lines := ratchet.worse(ratchet.kept(), found)), "\n".join(lines)
    assert all(most.mean >= MEAN for most in ratchet.kept().values())
