"""The options of a campaign on the command line."""

import pytest
import typer
from typer.testing import CliRunner

from s2r_spec.cli.options.protocols import Next, NoProtocols, Passive, Protocols, protocol_names
from s2r_spec.errors import UsageError
from tests.errors import naming


def names(*words):
    """Return what a command with these words would run."""
    app, found = typer.Typer(), []

    @app.command()
    def command(
        protocols: Protocols = None,
        no_protocols: NoProtocols = False,
        passive: Passive = False,
        after: Next = None,
    ):
        found.append(protocol_names(protocols, no_protocols, passive))

    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return found[0]


def test_which_protocols_a_command_line_allows():
    assert names("--next", "next.csv") is None
    assert names("--protocols", "squat, sway") == ("squat", "sway")
    assert names("--no-protocols") == names("--passive") == ()


@pytest.mark.parametrize(
    ("words", "facts"),
    [
        (("--protocols", "squat", "--passive"), ["--protocols", "--passive"]),
        (("--protocols", "squat,"), ["'squat,'"]),
    ],
)
def test_options_that_do_not_fit_are_refused(words, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        names(*words)
