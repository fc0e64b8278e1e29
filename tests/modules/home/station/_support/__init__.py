"""A household robot for the tests of its panel."""
