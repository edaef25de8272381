"""Cho, Kim, Leeghim 2015: every table, number and figure of the paper compared with our own.

Source: D.-H. Cho, D. Kim, H. Leeghim, Optimal Lunar Landing Trajectory Design for Hybrid Engine, Mathematical Problems
in Engineering 2015, 462072.
"""
