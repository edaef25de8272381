"""Liu, Liu, Wu 2019: why its example cannot be flown, and two neighbours of it that can.

Source: Liu, Liu, Wu, Mathematical Problems in Engineering 2019, 5319530, doi 10.1155/2019/5319530.
"""
