"""Methods: frozen records of settings with ``run(problem, guess, watch) -> Solution``."""
