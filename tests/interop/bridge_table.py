#!/usr/bin/env python3
"""bridge_table.py TWO_BOXES LINK [SECONDS]: measures the bridge over a link with delay, jitter and loss; prints docs/results/bridge.md.

TWO_BOXES is the example of that name of stgdat-bridge. LINK is a program that joins two network namespaces until it is
terminated: `LINK NS_A NS_B DELAY_MS JITTER_MS LOSS [CUT_FILE]`, with 10.78.0.1 in the first one and 10.78.0.2 in the second
one. While CUT_FILE exists, nothing passes. Needs root and `ip`. Both ends run on this machine, so they have one clock."""
import os, signal, subprocess, sys, tempfile, time

two_boxes, link = sys.argv[1:3]
seconds = int(sys.argv[3]) if len(sys.argv) > 3 else 60
names = [f"stgdat{os.getpid()}{end}" for end in "ab"]
HEAD = """# Two boxes

<!-- Written by tests/interop/bridge_table.py. -->

Latency of [the bridge](../bridge.md) between two network namespaces of one machine. Each case sends forecasts at 12.5 Hz
for {seconds} s over a link of 200 Mbit/s with this delay and loss in each direction. All agents have 3 modes: a frame has
{small:.1f} kB with 32 agents, {large:.1f} kB with 128. The latency counts from before the frame is written until it is read
completely, by one clock. A frame is *delivered* unless a newer one has replaced it before it was sent. Loss costs TCP a
round trip or a retransmission timeout (200 ms at least), and makes it send fewer packets at once.

```console
$ cargo build --release --package stgdat-bridge --example two_boxes
$ sudo chrt -f 20 python3 tests/interop/bridge_table.py target/release/examples/two_boxes LINK {seconds}
```

The script describes LINK. Other programs kept the machine busy, so all programs of the measurement had real-time priority.

| agents | delay, ms | loss, % | delivered, % | p50, ms | p99, ms | over 80 ms, % | oldest, ms |
|---:|---:|---:|---:|---:|---:|---:|---:|"""
CUT = """
## A cut of 5 s

The link is cut for 5 s after {before} s, with 5 ± 2 ms, 1 % loss and 32 agents.

| | |
|---|---:|
| oldest frame ever delivered | {oldest:.0f} ms |
| frames older than 1 s | {old} |
| first frame after the link was back | {back:.1f} s |
| connections | {connections} |

Plain TCP delivers the backlog of such a cut, which is 6.8 s old.

## Ages

The receiver knows only an upper bound of a frame's age, because it does not compare clocks. In all {frames} frames of this
page the bound was {below} times below the latency. It exceeded the latency by {excess:.1f} ms in the median over the link of
20 ± 10 ms without loss.
"""


def ip(*words):
    subprocess.run(["ip", *words], check=True)


def inside(name, *command, **more):
    return subprocess.Popen(["ip", "netns", "exec", name, two_boxes, *command], text=True, **more)


def measured(delay, jitter, loss, agents, cut=None):
    """(seq, latency, age, arrival) of each frame in ms, and when the link was back."""
    for name in names:
        ip("netns", "add", name)
    running, back = [], None
    try:
        arguments = [str(delay), str(jitter), str(loss / 100)] + ([cut] if cut else [])
        running.append(subprocess.Popen([link, *names, *arguments]))
        while any(subprocess.run(["ip", "-n", name, "addr", "show", "tun0"], capture_output=True).returncode for name in names):
            time.sleep(.1)
        time.sleep(.5)
        running.append(inside(names[0], "send", "10.78.0.1:4780", str(agents), str(seconds)))
        receiver = inside(names[1], "receive", "10.78.0.1:4780", str(seconds), stdout=subprocess.PIPE)
        running.append(receiver)
        if cut:
            time.sleep(seconds / 3)
            open(cut, "w").close()
            time.sleep(5)
            os.remove(cut)
            back = time.monotonic() * 1e3
        lines = receiver.communicate()[0].split("\n")[:-1]
        running[1].wait()
        rows = [tuple(map(int, line.split(" "))) for line in lines]
        return [(seq, latency / 1e3, age / 1e3, at / 1e3) for seq, latency, age, at in rows], back
    finally:
        for process in running:
            process.terminate()
            process.wait()
        for name in names:
            ip("netns", "delete", name)


def share(values, part):
    return sorted(values)[min(len(values) - 1, int(part * len(values)))]


def size(agents):
    return (48 + 72 + 16 + agents * (48 + 48 + 3 * 50)) / 1e3


def main():
    print(HEAD.format(seconds=seconds, small=size(32), large=size(128)), flush=True)
    frames, below, excess = 0, 0, 0
    for agents in (32, 128):
        for delay, jitter in ((0, 0), (5, 2), (20, 10)):
            for loss in (0, 1, 5):
                rows, _ = measured(delay, jitter, loss, agents)
                latency = [row[1] for row in rows]
                offered = max(row[0] for row in rows) - min(row[0] for row in rows) + 1
                late = 100 * sum(ms > 80 for ms in latency) / len(rows)
                name = f"{delay} ± {jitter}" if jitter else delay
                print(f"| {agents} | {name} | {loss} | {100 * len(rows) / offered:.1f} | {share(latency, .5):.1f} | "
                      f"{share(latency, .99):.0f} | {late:.1f} | {max(latency):.0f} |", flush=True)
                frames += len(rows)
                # The envelope has whole microseconds.
                below += sum(age + .003 < ms for _, ms, age, _ in rows)
                if (agents, delay, loss) == (32, 20, 0):
                    excess = share([age - ms for _, ms, age, _ in rows], .5)
    with tempfile.TemporaryDirectory() as folder:
        rows, back = measured(5, 2, 1, 32, folder + "/cut")
    after = [at for _, _, _, at in rows if at > back]
    gaps = sum(b[3] - a[3] > 2000 for a, b in zip(rows, rows[1:]))
    frames, below = frames + len(rows), below + sum(age + .003 < ms for _, ms, age, _ in rows)
    print(CUT.format(before=seconds // 3, oldest=max(row[1] for row in rows), old=sum(row[1] > 1000 for row in rows),
                     back=(after[0] - back) / 1e3, connections=1 + gaps, frames=frames, below=below, excess=excess), end="")


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    main()
