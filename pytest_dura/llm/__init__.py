"""Language models as the component under test (extra ``llm``)."""
