// Looks up rungs and variants by name, checks their parameters, and describes them as text for Python. CPU and CUDA
// share it; V and R are their types of variants and rungs.
#pragma once

#include "../core/registry.h"
#include "checks.h"

namespace bigtri {

// One line for each variant, followed by one for each of its parameters. Fields are separated by tabs; bigtri/native.py
// parses them. `variants` ends with a null pointer.
template <class V>
std::string registry_text(const V* const* variants) {
  std::string text;
  for (; *variants; ++variants) {
    text += std::string("variant\t") + (*variants)->name + "\t" + (*variants)->paper + "\n";
    for (const Parameter* p = (*variants)->parameters; p->name; ++p) {
      text += std::string("parameter\t") + p->name + "\t" + p->unit + "\t" + p->about;
      for (const int64_t v : {p->standard, p->low, p->high}) text += "\t" + std::to_string(v);
      text += "\t";
      for (const int64_t* only = p->only; only && *only >= 0; ++only)
        text += (only == p->only ? "" : ",") + std::to_string(*only);
      text += "\n";
    }
  }
  return text;
}

template <class V>
std::string names_of(const V* const* variants) {
  std::string names;
  for (const V* const* v = variants; *v; ++v) names += (v == variants ? "" : ", ") + std::string((*v)->name);
  return names;
}

template <class R>
std::string rung_names(const R* rungs) {
  std::string names;
  for (const R* r = rungs; r->name; ++r) names += (r == rungs ? "" : ", ") + std::string(r->name);
  return names;
}

// The array `rungs` ends with a rung whose name is null.
template <class R>
const R& find_rung(const char* op, const R* rungs, const std::string& precision) {
  const R* r = rungs;
  while (r->name && precision != r->name) ++r;
  BIGTRI_CHECK(r->name, "bigtri::", op, ": precision must be one of ", rung_names(rungs), ", got '", precision, "'");
  return *r;
}

// `where` goes into the error text after the names, e.g. " on CUDA": a variant may exist on another kind of device.
template <class V>
const V& find_variant(const char* op, const V* const* variants, const std::string& name, const std::string& precision,
                      const char* where) {
  const V* const* v = variants;
  while (*v && name != (*v)->name) ++v;
  BIGTRI_CHECK(*v, "bigtri::", op, ": variant must be one of ", names_of(variants), where, " with precision '",
               precision, "', got '", name, "'");
  return **v;
}

// The standard value of each parameter of the variant.
template <class V>
std::vector<int64_t> standard_values(const V& variant) {
  std::vector<int64_t> values;
  values.reserve((size_t)parameter_count(variant.parameters));
  for (const Parameter* p = variant.parameters; p->name; ++p) values.push_back(p->standard);
  return values;
}

// Returns one value for each parameter of the variant. `given` has as many, or none, which means the standard values.
template <class V>
std::vector<int64_t> checked_parameters(const char* op, const V& variant, const std::vector<int64_t>& given) {
  const size_t count = (size_t)parameter_count(variant.parameters);
  BIGTRI_CHECK(given.empty() || given.size() == count, "bigtri::", op, ": parameters must be none or ", count,
               " integers for variant '", variant.name, "', got ", given.size());
  if (given.empty()) return standard_values(variant);
  for (size_t i = 0; i < count; ++i) {
    const Parameter& p = variant.parameters[i];
    std::string allowed = std::to_string(p.low) + " to " + std::to_string(p.high);
    if (p.only) {
      allowed.clear();
      for (const int64_t* v = p.only; *v >= 0; ++v) allowed += (v == p.only ? "" : ", ") + std::to_string(*v);
    }
    BIGTRI_CHECK(p.allows(given[i]), "bigtri::", op, ": parameter ", p.name, " of variant '", variant.name,
                 "' must be ", allowed, ", got ", given[i]);
  }
  return given;
}

}  // namespace bigtri
