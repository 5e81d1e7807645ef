"""Link: a component or a simulator at the other end of a wire.

Frames go over a transport: a pipe, TCP, UDP, a serial line, CAN. A binding says which numbers of
percept, command and tick they hold, in which units.
"""
