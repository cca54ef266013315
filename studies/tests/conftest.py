import pytest


@pytest.fixture(scope="session")
def short_thesis():
    """All of the thesis, as short as possible and on ideal drives only; both drives get these
    results."""
    from studies.thesis import arbitrary, collision, eight, faults, line, study

    straight = line.measure("ideal", 0.03, 1)
    course = eight.measure("ideal", 4.0)
    hits = collision.measure("ideal")
    free = arbitrary.measure("ideal", False, 0.6, 2.5)
    broken = (faults.not_a_number("ideal"),)
    return study.Measured(
        [straight] * 2,
        line.simulated(0.03),
        [course] * 2,
        eight.mechanism(4.0),
        [hits] * 2,
        {False: [free] * 2},
        [broken] * 2,
    )
