"""What every command does alike: arguments, exit codes, the terminal and the log, signals, groups of commands.

Others use the modules named here. None is imported: a command waits only for what it uses.
"""
