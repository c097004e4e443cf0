"""Random numbers that are the same with every version of Python."""


class Draws:
    def __init__(self, seed):
        self.seed = seed

    def uniform(self):
        self.seed = (1103515245 * self.seed + 12345) % 2**31
        return self.seed / 2**31

    def normal(self):
        """A number of nearly the standard normal distribution."""
        return 1.7 * (sum(self.uniform() for _ in range(4)) - 2.0)
