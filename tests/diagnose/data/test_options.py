"""The options of a campaign on the command line."""

import pytest
import typer
from typer.testing import CliRunner

from s2r_spec.cli.diagnose import Campaign
from s2r_spec.cli.options.groups import group_options
from s2r_spec.errors import UsageError
from tests.errors import naming


def names(*words):
    """Return what a command with these words would run."""
    app, found = typer.Typer(), []

    @app.command()
    @group_options
    def command(*, campaign: Campaign):
        found.append(campaign.names())

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
