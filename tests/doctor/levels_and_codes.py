"""Checks of the form of findings, common to all tests of the doctor."""

from cardan.doctor.base import Finding, FindingLevel


def levels_and_codes(check, findings):
    """Return the levels and codes of findings in their order; check the form of each."""
    found = [findings] if isinstance(findings, Finding) else list(findings)
    for each in found:
        assert each.code in check.tells, f"{check.__name__} does not declare {each.code!r}"
        assert "\n" not in each.what
        bad = each.level is not FindingLevel.GOOD
        assert bool(each.why) == bool(each.mend) == bad, each
    return [(each.level.value, each.code) for each in found]
