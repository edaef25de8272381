"""Peng, Li, Shen, Tang 2012: descent from over the pole by Gauss points, a genetic search and Pontryagin.

Source: Q. Peng, H. Li, H. Shen, G. Tang, Genetic Algorithm for finite-thrust trajectory optimization, in Genetic
Algorithms in Applications, InTech 2012, section 4.
"""
