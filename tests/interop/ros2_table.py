"""The tables of docs/results/ros2.md."""

import os

from ros2_bridge import domains, round_trip, stopped_reader, without_and_with

COUNTS = (8, 32, 128)


def rows(head, lines):
    return "\n".join([head, "|---" + "|---:" * (head.count("|") - 2) + "|", *lines])


def ms(value):
    return f"{value:.3g}"


def latencies(name, found):
    return (f"| {name} | {found['sent']} | {found['lost']} | {ms(found['p50_ms'])} | {ms(found['p99_ms'])} "
            f"| {ms(found['max_ms'])} |")


def table(programs, types, seconds="16"):
    text, lines, load = [], [], os.getloadavg()[1]
    for count in COUNTS:
        found = round_trip(programs, types, count, float(seconds))
        lines.append(latencies(count, found)[:-1] + f"| {ms(found['end_to_end_p50_ms'])} | {ms(found['published_p50_ms'])} | {found['bytes'] / 1e3:.1f} "
                     f"| {found['late']} of {found['ticks']} |")
    head = "| objects | sent | lost | p50, ms | p99, ms | max, ms | pipeline p50, ms | published p50, ms | answer, kB | late ticks |"
    text.append(rows(head, lines))

    found = stopped_reader(programs, types)
    log, run, after, again = (found.pop(key) for key in ("log", "run", "after", "again"))
    lines = [latencies(f"beside it: {phase}", figures) for phase, figures in found.items()]
    lines += [latencies("the reader itself, continued", after), latencies("the reader itself, started again", again)]
    text.append(rows("| reader | sent | lost | p50, ms | p99, ms | max, ms |", lines))
    text.append(f"Late ticks of this run: {run['late']} of {run['ticks']}.")

    found = domains(programs, types)
    text.append(f"Messages of the bridge in domain 7: a reader in domain 7 received {found['same']['answered']} of "
                f"{found['same']['sent']}, a reader in domain 0 received {found['other']}.")

    lines = []
    for count in (32, 128):
        for name, found in without_and_with(programs, count, float(seconds)).items():
            lines.append(f"| {count} | {name} | {found['late']} of {found['ticks']} | {ms(found['end_to_end_p99_ms'])} |")
    text.append(rows("| agents | bridge | late ticks | end to end p99, ms |", lines))
    text.append(f"{os.cpu_count()} processors, load average {load:.1f} before and {os.getloadavg()[1]:.1f} after.")
    return "\n\n".join(text)
