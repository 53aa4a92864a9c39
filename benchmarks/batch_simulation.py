"""A hundred thousand assets on a thousand workers: how long, how full, and what breaks first.

An event simulation of the batch as it works: a driver that hands out items, workers of one item at a time that start
cold, crash, are preempted with their machine and go on from their last checkpoint, poisoned items that are quarantined,
and a driver that is killed and started again. Rates of the machines are assumptions, named here; the cost of an item is
measured.
"""

from __future__ import annotations

import heapq
import random
from collections import Counter
from dataclasses import asdict, dataclass

from benchmarks import record
from benchmarks.inputs import Inputs


@dataclass(frozen=True)
class Assumptions:
    """Seconds unless said otherwise.

    item, spread: median of the duration of an item on one thread, and σ of its logarithm. checkpoint: work between two
        checkpoints. prepare: before the first iteration, done again after each resumption.
    cold: start of a worker. per_machine: workers that a machine takes with it. preempted_per_hour: of machines, in
        shares; back: until another one is there.
    crash: probability that an item kills its worker once; poison: that it always does; hang: that it runs into the time
        limit. driver_kills: of the driver; driver_back: until it is started again and has read manifest and journal.
    handout: of the driver per item. reads, writes: requests to the object store per item. megabytes: of results.
    """

    items: int = 100_000
    workers: int = 1000
    item: float = 60.0
    spread: float = 0.4
    checkpoint: float = 10.0
    prepare: float = 15.0
    cold: float = 12.0
    per_machine: int = 8
    preempted_per_hour: float = 0.05
    back: float = 120.0
    crash: float = 0.002
    poison: float = 0.0005
    hang: float = 0.0002
    time_limit: float = 4 * 3600.0
    driver_kills: int = 2
    driver_back: float = 120.0
    handout: float = 0.012
    reads: int = 6
    writes: int = 16
    megabytes: float = 12.0
    seed: int = 0


def main(inputs: Inputs) -> None:
    """Simulate the standard case and variants of it.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
    """
    standard = Assumptions()
    variants = {
        "standard": standard,
        "nothing fails": Assumptions(preempted_per_hour=0, crash=0, poison=0, hang=0, driver_kills=0),
        "a third of the machines preempted per hour": Assumptions(preempted_per_hour=0.33),
        "time limit of 10 minutes": Assumptions(time_limit=600.0),
        "content hashed over the network, 100 ms an item": Assumptions(handout=0.1),
        "10,000 workers": Assumptions(workers=10_000),
    }
    results = {name: simulate(one) for name, one in variants.items()}
    for name, one in results.items():
        print(f"{name}: {one}")
    record.write_entry("batch", "simulation", {"assumptions": asdict(standard), "variants": results})


def simulate(given: Assumptions, crashes: int = 3) -> dict:
    """One batch from the first item to the last.

    Returns:
        hours until all items have an outcome, and until 99 % of them; up to then, the share of the time of all workers
        that went into results (of the rest, most is the preparation of each start), how busy the driver was, and
        requests to the store per second; counts of what happened.
    """
    chance, counts = random.Random(given.seed), Counter()
    todo = [_Item(chance, given) for _ in range(given.items)][::-1]
    events: list[tuple[float, int, str, int]] = []
    number = 0

    def at(when: float, what: str, who: int) -> None:
        nonlocal number
        heapq.heappush(events, (when, number, what, who))
        number += 1

    machines = given.workers // given.per_machine
    alive = [True] * machines
    warm, current, since = [False] * given.workers, [None] * given.workers, [0.0] * given.workers
    epoch = [0] * given.workers  # events of an earlier life of a worker do not count
    driver_free, driver_busy, driver_down = 0.0, 0.0, 0.0
    useful, ends = 0.0, list[float]()
    kills = sorted(chance.uniform(0.1, 0.8) for _ in range(given.driver_kills))
    expected = given.items * given.item * 1.1 / given.workers
    for share in kills:
        at(share * expected, "driver", 0)
    if given.preempted_per_hour:
        for machine in range(machines):
            at(chance.expovariate(given.preempted_per_hour / 3600), "preempt", machine)
    for worker in range(given.workers):
        at(0.0, "free", worker)

    def begin(now: float, worker: int) -> None:
        nonlocal driver_free, driver_busy
        if not todo or not alive[worker // given.per_machine] or current[worker] is not None:
            return
        item = todo.pop()
        start = max(now, driver_free, driver_down)  # the driver hands out one item after the other
        driver_free, driver_busy = start + given.handout, driver_busy + given.handout
        start += given.handout + (0.0 if warm[worker] else given.cold)
        warm[worker], current[worker], since[worker] = True, item, start
        item.starts += 1
        epoch[worker] += 1
        left = item.seconds - item.saved + given.prepare
        if item.poison or (item.crash and item.starts == 1):
            at(start + left * chance.random(), f"crash {epoch[worker]}", worker)
        elif item.hang:
            at(start + given.time_limit, f"limit {epoch[worker]}", worker)
        else:
            at(start + left, f"done {epoch[worker]}", worker)

    def lost(now: float, worker: int) -> None:
        """What a worker had is to be done again, from its checkpoint."""
        item, current[worker] = current[worker], None
        warm[worker] = False
        epoch[worker] += 1
        if item is not None:
            done = max(0.0, now - since[worker] - given.prepare)
            item.saved = min(item.seconds, item.saved + done // given.checkpoint * given.checkpoint)
            todo.append(item)

    now = 0.0
    while events and len(ends) < given.items:
        now, _, what, who = heapq.heappop(events)
        kind, _, life = what.partition(" ")
        if life and int(life) != epoch[who]:
            continue
        if kind == "free":
            begin(now, who)
        elif kind == "done":
            if len(ends) < 0.99 * given.items:
                useful += current[who].seconds
            current[who] = None
            ends.append(now)
            begin(now, who)
        elif kind == "limit":
            counts["over the time limit"] += 1
            current[who], warm[who] = None, False
            ends.append(now)
            begin(now, who)
        elif kind == "crash":
            counts["crashes"] += 1
            item = current[who]
            lost(now, who)
            item.crashes += 1
            if item.crashes >= crashes:
                counts["quarantined"] += 1
                todo.remove(item)
                ends.append(now)
            begin(now, who)
        elif kind == "preempt":
            counts["machines preempted"] += 1
            alive[who] = False
            for worker in range(who * given.per_machine, (who + 1) * given.per_machine):
                lost(now, worker)
            at(now + given.back, "machine", who)
            idle = (w for w in range(given.workers) if alive[w // given.per_machine] and current[w] is None)
            for worker in list(idle)[: given.per_machine]:
                begin(now, worker)
        elif kind == "machine":
            alive[who] = True
            at(now + chance.expovariate(given.preempted_per_hour / 3600), "preempt", who)
            for worker in range(who * given.per_machine, (who + 1) * given.per_machine):
                begin(now, worker)
        elif kind == "driver":  # with Ray all tasks end with it
            counts["driver killed"] += 1
            driver_down = now + given.driver_back
            for worker in range(given.workers):
                lost(now, worker)
                at(driver_down, "free", worker)
    ends.sort()
    requests = (given.reads + given.writes) * given.items
    return {
        "hours": round(ends[-1] / 3600, 2),
        "hours_to_99_percent": round(ends[int(0.99 * len(ends))] / 3600, 2),
        "outcomes": len(ends),
        "share_of_time_useful": round(useful / (given.workers * ends[int(0.99 * len(ends))]), 3),
        "driver_busy": round(driver_busy / ends[int(0.99 * len(ends))], 3),
        "store_requests_per_second": round(requests / ends[int(0.99 * len(ends))]),
        "terabytes": round(given.items * given.megabytes / 1e6, 2),
        "journal_megabytes": round(given.items * 800 / 1e6),
        **counts,
    }


class _Item:
    """How long an item takes, what happens to it, and what of it is on disk."""

    __slots__ = ("crash", "crashes", "hang", "poison", "saved", "seconds", "starts")

    def __init__(self, chance: random.Random, given: Assumptions) -> None:
        self.seconds = given.item * chance.lognormvariate(0.0, given.spread)
        fate = chance.random()
        self.poison = fate < given.poison
        self.hang = given.poison <= fate < given.poison + given.hang
        self.crash = given.poison + given.hang <= fate < given.poison + given.hang + given.crash
        self.saved, self.starts, self.crashes = 0.0, 0, 0
