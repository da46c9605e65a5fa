"""The table of the suite's times."""

from tests import suite_time

REPORT = """<testsuites><testsuite name="pytest" tests="3" time="2.5">
<testcase classname="tests.cli.test_check" name="test_a[x.y-1]" time="1.25"/>
<testcase classname="tests.certify.test_search.TestRefusals" name="test_b" time="2.0"/>
<testcase classname="tests.cli.test_check" name="test_c" time="0.5"/>
</testsuite></testsuites>"""


def test_the_time_of_the_suite_is_told_by_folder(tmp_path):
    (tmp_path / "suite.xml").write_text(REPORT)
    found = suite_time.times(tmp_path / "suite.xml")
    assert [(file, seconds) for file, _, seconds in found] == [
        ("tests/cli/test_check.py", 1.25),
        ("tests/certify/test_search.py", 2.0),
        ("tests/cli/test_check.py", 0.5),
    ]
    lines = suite_time.table(found, 2.5).splitlines()
    assert lines[0].startswith("3 tests, 4 s in them")
    assert [line.split()[-1] for line in lines[3:5]] == ["tests/certify", "tests/cli"]
    assert [line.split()[:2] for line in lines[3:5]] == [["2.0", "53"], ["1.8", "47"]]
