from __future__ import annotations

import time
from threading import Event, Thread

from napari_elsplus.acquisition.streaming.usage import process_age_s, thread_times_s


def test_processor_time_is_counted_for_the_thread_that_used_it() -> None:
    done, hold = Event(), Event()

    def work(seconds: float) -> None:
        begin_s = time.thread_time()
        while time.thread_time() - begin_s < seconds:
            pass
        done.set()
        hold.wait(10)

    before = thread_times_s()
    Thread(target=work, args=(0.2,), name="busy", daemon=True).start()
    assert done.wait(60)
    after = thread_times_s()
    hold.set()
    assert "busy" not in before
    assert 0.15 < after["busy"] < 0.3


def test_the_age_is_that_of_the_process() -> None:
    first_s, begin_s = process_age_s(), time.perf_counter()
    time.sleep(0.05)
    assert abs(process_age_s() - first_s - (time.perf_counter() - begin_s)) < 0.02
    assert first_s > 0
