"""A client that reconnects from its address gets its number again."""

from cardan.gateway.servers.numbers import CAPACITY, RETENTION_S, ClientNumbers


def test_who_comes_back_has_its_number_and_who_is_here_keeps_it():
    numbers = ClientNumbers(lambda: 0.0)
    with numbers.of("10.0.0.1") as first, numbers.of("10.0.0.1") as second:
        assert (first, second) == (1, 2)
    with numbers.of("10.0.0.2") as other, numbers.of("10.0.0.1") as again:
        assert (other, again) == (3, 1)  # number of the last client that left


def test_numbers_are_forgotten_after_an_hour_and_before_they_fill_the_memory():
    now_s = [0.0]
    numbers = ClientNumbers(lambda: now_s[0])
    with numbers.of("10.0.0.1"):
        pass
    now_s[0] = RETENTION_S + 1.0
    with numbers.of("10.0.0.1") as again:
        assert again == 2
    for number in range(10 * CAPACITY):
        with numbers.of(f"10.1.0.{number}"):
            pass
    assert len(numbers._left) == CAPACITY
