"""Answer queries: candidates, the best of them, its refusal or its local minimum; slices and batches."""
