"""Level 2: the first-order necessary conditions, from the minimum principle to contact points."""
