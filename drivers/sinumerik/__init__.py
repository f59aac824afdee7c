"""SINUMERIK controls over OPC UA.

`make_sinumerik` makes the driver itself: it loads OPC UA, which takes half a second and 20 MB.
"""
