"""docs/troubleshooting.md explains every finding, and its example of a check works."""

from cardan.doctor import registry
from cardan.doctor.base import Check, Subject
from tests.doctor.levels_and_codes import levels_and_codes
from tests.test_docs import blocks, rows, section, text

PAGE = section(text("troubleshooting.md"), "What is wrong here: `cardan doctor`")


def test_every_finding_is_explained_and_no_other():
    explained = {code for code in rows(PAGE) if not code.startswith("--")}
    tells = {code for name in registry.names() for code in registry.load(name).tells}
    assert explained == tells


def test_the_example_of_a_check():
    (source,) = blocks(PAGE, "python")
    names: dict[str, type[Check]] = {}
    exec(source, names)  # type: ignore[arg-type]
    check = names["LeverCheck"]
    for answer, level in ((None, "failure"), ("it runs", "good")):
        subject = Subject(run=lambda words, answer=answer: answer)
        assert levels_and_codes(check, check.look(subject)) == [(level, "lever-daemon")]
