"""How the trials are cut into blocks."""

from simulator.study.trials import blocks
from simulator.study.trials.blocks import Blocks, Result


def finish(todo, block, trial_s):
    todo.finished(Result(block, None, trial_s * len(block)))


def test_every_trial_is_handed_out_once_whatever_they_cost():
    for trial_s in (1e-7, 0.003, 0.1, 30.0):
        todo = Blocks([range(3, 40), range(100, 900)], workers=3)
        seen = []
        while todo:
            block = todo.take()
            seen += block
            finish(todo, block, trial_s)
        assert seen == [*range(3, 40), *range(100, 900)]
        assert todo.left == 0


def test_blocks_grow_to_the_time_they_should_take_and_shrink_at_the_end():
    todo = Blocks([range(100_000)], workers=2)
    sizes = []
    while todo:
        block = todo.take()
        sizes.append(len(block))
        finish(todo, block, 0.01)
    assert sizes[0] == blocks.FIRST_TRIALS
    assert set(sizes[1:-30]) == {round(blocks.TARGET_S / 0.01)}
    assert sizes[-1] <= 20
    dear = Blocks([range(100)], workers=2)
    finish(dear, dear.take(), 10.0)
    assert len(dear.take()) == 1


def test_a_block_whose_worker_dies_comes_back_until_it_is_suspected():
    todo = Blocks([range(100)])
    first, second = todo.take(), todo.take()
    for _ in range(blocks.MAX_ATTEMPTS - 1):
        assert todo.give_back([first, second])
        assert todo.left == 100
        assert [todo.take(), todo.take()] == [first, second]
    finish(todo, second, 0.1)
    assert not todo.give_back([first])
