"""Estimators: streams and initial poses in, a posterior out. No files, no terminals."""
