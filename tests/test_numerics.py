"""The claims of docs/numerics.md hold: its commands give what it says."""

import doctest
import re
import shlex
from pathlib import Path

from oitlab import _stress_command, cli

PAGE = Path(__file__).parents[1] / "docs" / "numerics.md"


def test_every_command_gives_what_the_page_says() -> None:
    text = re.sub(r"^```.*$", "", PAGE.read_text(), flags=re.MULTILINE)
    examples = doctest.DocTestParser().get_doctest(text, {}, PAGE.name, str(PAGE), 0)
    assert len(examples.examples) > 30
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    report: list[str] = []
    runner.run(examples, out=report.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(report)


def test_its_shell_commands_are_ours() -> None:
    commands = re.findall(r"^oitlab .*$", PAGE.read_text(), flags=re.MULTILINE)
    assert len(commands) == 2
    for command in commands:
        options = cli._parser().parse_args(shlex.split(command, comments=True)[1:])
        assert options.run is _stress_command.run
