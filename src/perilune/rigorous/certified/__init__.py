"""Certificate checks: `form`, `expressions`, `equations`, `steps`, least H (`minimum`), second order (`optimum`)."""
