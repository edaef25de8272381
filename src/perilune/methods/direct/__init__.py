"""Direct methods: initial mesh, transcription, pseudospectral collocation."""
