"""Deorbit and entry: from an orbit, through a finite burn and a coast, to the air and through it to a site."""
