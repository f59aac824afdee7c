"""OPC UA sessions, and servers whose nodes are channels.

The session loads asyncua (half a second, 20 MB), the functions for certificates load cryptography (15 MB): import them
where they are used.
"""
