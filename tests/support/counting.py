"""How many operations a function takes, counted while it runs."""


class Counted(float):
    """A number that counts the operations that it takes part in: `done`, of all such numbers together."""

    done = 0

    def _after(self, result):
        Counted.done += 1
        return Counted(result)

    def __add__(self, other):
        return self._after(float(self) + float(other))

    def __sub__(self, other):
        return self._after(float(self) - float(other))

    def __mul__(self, other):
        return self._after(float(self) * float(other))

    def __truediv__(self, other):
        return self._after(float(self) / float(other))
