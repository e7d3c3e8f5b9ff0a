import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cell_firmware.firmware import Inbox
from cell_firmware.tiles.messages import TALK, ahead_by, gathered, is_word, newest, older, version, word

WRAP = 1 << 16


def tile_words(versions: list[int], fresh: list[int]) -> np.ndarray:
    pairs = zip(versions, fresh, strict=True)
    return np.array([[word(np.array(number), one, 4, 1, number) if one else 0 for number, one in pairs]])


@given(
    st.lists(st.tuples(st.integers(0, 300), st.integers(0, 255)), min_size=1, max_size=5),
    st.integers(0, WRAP - 1),
    st.randoms(use_true_random=False),
)
def test_the_newest_word_is_the_same_wherever_versions_begin_and_whoever_sends_it(
    words: list[tuple[int, int]], first: int, chance: object
) -> None:
    """Versions are what they were plus ``first``, modulo 65,536; the right answer is found without a wrap."""
    known = [(number, fresh) for number, fresh in words if fresh]
    best = max(known, default=(0, 0))
    chance.shuffle(words)  # type: ignore[attr-defined]
    found = newest(
        tile_words([(number + first) % WRAP for number, _ in words], [fresh for _, fresh in words])
    )
    assert int(found[0] >> 32 & 255) == best[1]
    assert not known or int(version(found)[0]) == (best[0] + first) % WRAP


def test_a_version_is_newer_by_less_than_half_of_all_as_in_rfc_1982() -> None:
    for own, ahead, newer in [
        (65_535, 1, True),
        (65_535, 32_767, True),
        (0, 32_767, True),
        (0, 32_769, False),
    ]:
        other = (own + ahead) % WRAP
        (found,) = version(newest(tile_words([own, other], [9, 9]))).tolist()
        assert found == (other if newer else own)


def test_a_word_goes_on_from_65535_with_0_and_keeps_all_else() -> None:
    last = word(np.array([65_530]), 40, 5 * 4 + 1, 3, 777)
    assert version(ahead_by(last, 16)).tolist() == [10]
    assert (ahead_by(last, 16) & (1 << 40) - 1).tolist() == (last & (1 << 40) - 1).tolist()
    assert version(word(version(last) + 6, 40, 0, 0, 0)).tolist() == [0]
    assert is_word(ahead_by(last, 16)).tolist() == [True]


def test_what_is_not_fresh_any_more_is_no_word_whatever_its_version() -> None:
    assert newest(older(tile_words([65_535, 3], [1, 1]))).tolist() == [0]
    assert newest(older(tile_words([65_535, 3], [2, 1]))).tolist() == tile_words([65_535], [1])[0].tolist()


def test_bits_outside_a_word_are_no_word() -> None:
    assert is_word(np.array([1 << 56, -1, (1 << 56) - 1, 0])).tolist() == [False, False, True, True]


def test_labels_that_differ_make_none_that_nobody_has_read() -> None:
    """A tile has several readers: 4 and 1 of one round are 4, not 5, and an older round's label does not count."""
    inbox = Inbox(np.ones((1, 4), dtype=np.bool_), np.zeros((1, 4), dtype=np.dtype(TALK)))
    inbox.message["pulse"] = [[255 << 24 | 9 << 8 | 40, 255 << 24 | 9 << 8 | 40, 255 << 24 | 8 << 8 | 40, 0]]
    inbox.message["alive"] = [[1, 2, 4, 0]]
    inbox.message["label"] = [[4, 1, 8, 16]]
    state = {
        "mate": inbox.received,
        **{name: np.zeros(1, dtype=np.int64) for name in ("pulse", "alive", "covered", "label")},
    }
    pulse, alive, covered, label = gathered(state, inbox)
    assert [pulse.tolist(), alive.tolist(), covered.tolist(), label.tolist()] == [
        [255 << 24 | 9 << 8 | 39],
        [3],
        [0],
        [4],
    ]
