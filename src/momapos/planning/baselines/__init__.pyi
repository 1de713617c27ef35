from .by_method import plan_with_method as plan_with_method
