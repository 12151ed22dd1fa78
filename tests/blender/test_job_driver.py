"""The job driver with a window made up for it: however a job ends, nothing of it stays."""

from itertools import count
from time import monotonic
from types import SimpleNamespace

import pytest
from prt_baker.addon import run_state
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.job import Progress
from prt_baker.operators import job_driver
from prt_baker.operators.job_driver import JobOperator

TIMER = SimpleNamespace(type="TIMER", value="NOTHING")
ESC = SimpleNamespace(type="ESC", value="PRESS")
WAITING = Progress("waiting", -1.0)


class Window:
    """What the driver needs of Blender: timers, handlers, a sidebar to draw anew."""

    def __init__(self):
        self.timers, self.handlers, self.redraws = [], [], 0
        sidebar = SimpleNamespace(type="UI", tag_redraw=self._redraw)
        viewport = SimpleNamespace(type="WINDOW")  # has no tag_redraw: it must not be asked
        area = SimpleNamespace(type="VIEW_3D", regions=[viewport, sidebar])
        self.windows = [SimpleNamespace(screen=SimpleNamespace(areas=[area]))]

    def _redraw(self):
        self.redraws += 1

    def event_timer_add(self, step, window):
        self.timers.append(step)
        return step

    def event_timer_remove(self, timer):
        self.timers.remove(timer)

    def modal_handler_add(self, operator):
        self.handlers.append(operator)


class Toy(JobOperator):
    """An operator whose job is the generator function it was given."""

    bl_label = "Toy"

    def __init__(self, job):
        self.job, self.status, self.reports = job, None, []

    def steps(self, context):
        return self.job()

    def done(self):
        return "Done"

    def report(self, kinds, text):
        self.reports.append((*kinds, text))

    def _set_status(self, text):
        self.status = text


@pytest.fixture
def context():
    window = Window()
    yield SimpleNamespace(
        window_manager=window, window=None, workspace=SimpleNamespace(name="Layout")
    )
    assert run_state.current() is None
    assert window.timers == []


def recorded(*steps, log):
    """A job of ``steps``, an exception among them being raised, that logs how it ended."""

    def job():
        try:
            for step in steps:
                if isinstance(step, Exception):
                    raise step
                yield step
            log.append("whole")
        finally:
            log.append("closed")
        return {}

    return job


def bar(*fractions):
    return [Progress("transfer", fraction, 0, 1.0) for fraction in fractions]


def start(job, context):
    toy = Toy(job)
    assert toy.invoke(context, None) == {"RUNNING_MODAL"}
    assert context.window_manager.handlers == [toy]
    return toy


def tick_to_the_end(toy, context):
    for _ in range(1000):
        result = toy.modal(context, TIMER)
        if result != {"PASS_THROUGH"}:
            return result
    raise AssertionError("the job does not end")


def test_ticks_carry_a_job_to_its_end(context):
    log = []
    toy = start(recorded(*bar(0.1, 0.5, 0.9), log=log), context)
    assert tick_to_the_end(toy, context) == {"FINISHED"}
    assert log == ["whole", "closed"]
    assert toy.reports == [("INFO", "Done")]
    assert toy.status is None


def test_panel_and_status_bar_follow(context):
    toy = start(recorded(*bar(0.25), WAITING, WAITING, log=[]), context)
    redraws = context.window_manager.redraws
    toy.modal(context, TIMER)
    assert run_state.current().progress.fraction == 0.25
    assert toy.status == "Toy: Tracing, 25 %, 3 s left (Esc to cancel)"
    assert context.window_manager.redraws == redraws + 1
    toy.modal(context, TIMER)
    assert run_state.current().progress.fraction == 0.25, "waiting moves no bar"
    assert context.window_manager.redraws == redraws + 1, "nothing new, nothing drawn"
    toy.cancel(context)


def test_a_tick_is_short_however_often_the_job_yields(context):
    toy = start(lambda: (Progress("transfer", 1 - 1 / n) for n in count(1)), context)
    since = monotonic()
    toy.modal(context, TIMER)
    assert monotonic() - since < job_driver.SLICE + 0.1
    assert run_state.current().progress.fraction > 0.9, "and not only one step is taken"
    toy.cancel(context)


def test_a_tick_does_not_spin_while_the_job_waits(context):
    taken = []

    def job():
        while True:
            taken.append(1)
            yield WAITING

    toy = start(job, context)
    toy.modal(context, TIMER)
    assert len(taken) == 1
    toy.cancel(context)


@pytest.mark.parametrize(("kind", "value"), [("MOUSEMOVE", "NOTHING"), ("ESC", "RELEASE")])
def test_other_events_are_for_blender(context, kind, value):
    log = []
    toy = start(recorded(*bar(0.1, 0.2), log=log), context)
    event = SimpleNamespace(type=kind, value=value)
    assert toy.modal(context, event) == {"PASS_THROUGH"}
    assert log == []
    assert run_state.current().progress.fraction == 0
    toy.cancel(context)


def test_esc_cancels_at_once(context):
    log = []
    toy = start(recorded(*bar(0.1, 0.2), WAITING, *bar(0.3), log=log), context)
    toy.modal(context, TIMER)
    assert toy.modal(context, ESC) == {"CANCELLED"}
    assert log == ["closed"]
    assert toy.status is None
    assert toy.reports == [("INFO", "Toy was cancelled: nothing was changed")]


def test_esc_before_the_first_tick_cancels(context):
    toy = start(recorded(*bar(0.1), log=[]), context)
    assert toy.modal(context, ESC) == {"CANCELLED"}


def test_the_cancel_button_does_what_esc_does(context):
    log = []
    toy = start(recorded(*bar(0.1), WAITING, WAITING, log=log), context)
    toy.modal(context, TIMER)
    run_state.current().stop = True
    assert toy.modal(context, TIMER) == {"CANCELLED"}
    assert log == ["closed"]


def test_a_bake_error_is_told(context):
    log = []
    toy = start(recorded(*bar(0.1), BakeError("No light"), log=log), context)
    assert tick_to_the_end(toy, context) == {"CANCELLED"}
    assert log == ["closed"]
    assert toy.reports == [("ERROR", "No light")]
    assert toy.status is None


def test_a_bug_keeps_its_traceback_and_clears_up(context):
    log = []
    toy = start(recorded(*bar(0.1), ZeroDivisionError("ours"), log=log), context)
    with pytest.raises(ZeroDivisionError):
        tick_to_the_end(toy, context)
    assert log == ["closed"]
    assert toy.reports == []
    assert toy.status is None
    assert toy.modal(context, TIMER) == {"CANCELLED"}, "Blender may ask once more"


def test_a_job_that_cannot_begin_leaves_nothing(context):
    def job():
        raise BakeError("Nothing is selected")

    toy = Toy(job)
    assert toy.invoke(context, None) == {"CANCELLED"}
    assert toy.reports == [("ERROR", "Nothing is selected")]
    assert context.window_manager.handlers == []


def test_blender_closing_closes_the_job(context):
    log = []
    toy = start(recorded(*bar(0.1), WAITING, WAITING, log=log), context)
    toy.modal(context, TIMER)
    toy.cancel(context)
    toy.cancel(context)
    assert log == ["closed"]
    assert toy.reports == []


def test_switching_the_add_on_off_closes_the_job(context, monkeypatch):
    log = []
    toy = start(recorded(*bar(0.1), WAITING, WAITING, log=log), context)
    toy.modal(context, TIMER)
    monkeypatch.setattr(job_driver.bpy, "context", context)
    job_driver.stop()
    assert log == ["closed"]


def test_a_second_job_is_refused_and_the_first_goes_on(context):
    log = []
    first = start(recorded(*bar(0.1, 0.2), log=log), context)
    second = Toy(recorded(log=[]))
    assert second.invoke(context, None) == {"CANCELLED"}
    assert second.reports == [
        ("ERROR", "Toy is running: wait for it, or press Esc to cancel it"),
    ]
    assert tick_to_the_end(first, context) == {"FINISHED"}
    assert log == ["whole", "closed"]


def test_execute_runs_to_the_end_without_a_window(context):
    log = []
    toy = Toy(recorded(*bar(0.1, 0.2), WAITING, log=log))
    assert toy.execute(context) == {"FINISHED"}
    assert log == ["whole", "closed"]
    assert context.window_manager.handlers == []


def test_execute_tells_a_bake_error_and_raises_a_bug(context):
    toy = Toy(recorded(BakeError("No light"), log=[]))
    assert toy.execute(context) == {"CANCELLED"}
    assert toy.reports == [("ERROR", "No light")]
    with pytest.raises(ZeroDivisionError):
        Toy(recorded(ZeroDivisionError(), log=[])).execute(context)
