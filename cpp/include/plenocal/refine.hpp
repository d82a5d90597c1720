// Refinement of camera, board and poses by non-linear least squares, and the uncertainty of the
// result.
#pragma once

#include <array>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "plenocal/board.hpp"
#include "plenocal/loss.hpp"
#include "plenocal/matrix.hpp"
#include "plenocal/projection.hpp"

namespace plenocal {

/// A BAP feature of a board point, observed in a frame through micro-lens (k, l). rho and its
/// standard deviation are not used for a pinhole array.
struct FeatureObservation {
  int frame = 0;                  ///< index into the poses
  Vector3<double> board_point{};  ///< mm, of the flat grid, board frame
  int k = 0, l = 0;
  Feature<double> observed{};              ///< px
  Feature<double> std_dev{1.0, 1.0, 1.0};  ///< px, times that of `CostOptions`
};

/// An observed micro-image centre.
struct CenterObservation {
  int k = 0, l = 0;
  Pixel<double> observed{};  ///< px
  double std_dev = 1.0;      ///< px, of u and of v, times that of `CostOptions`
};

/// Everything observed.
struct Observations {
  std::vector<FeatureObservation> features;
  std::vector<CenterObservation> centers;
  /// The board that the features show. Its shape is where the refinement starts, or what it keeps.
  Board board{};
};

/// Name of |m|, mm (`micro_image_slope`), among the quantities of priors.
constexpr char kSlopeName[] = "m";

/// Name of q'_i, mm (`blur_intercept`), among the quantities of priors: "q'_1" for lens type 0.
inline std::string intercept_name(int lens_type) { return "q'_" + std::to_string(lens_type + 1); }

/// Names of the tilt gradient of the array along u and v, 1/mm (`tilt_gradient`), among the
/// quantities of priors.
constexpr std::array<const char*, 2> kTiltGradientNames = {"tilt_u", "tilt_v"};

/// What is known of a camera beforehand: one more residual, (quantity - value) / std_dev.
struct Prior {
  /// A free parameter, see `shared_names`, `kSlopeName`, an `intercept_name` or one of
  /// `kTiltGradientNames`.
  std::string quantity;
  double value;    ///< in the unit of the quantity
  double std_dev;  ///< likewise
};

/// The cost function: 1/2 sum rho(|r / sigma|^2) over all observations + w/2 sum r_a^2 over the
/// priors. A residual has the sigma of its observation (1 px unless given) times the factor for its
/// kind.
struct CostOptions {
  double uv_std_dev = 1.0;       ///< of a feature's u and v
  double rho_std_dev = 1.0;      ///< of a feature's rho
  double centers_std_dev = 1.0;  ///< of a centre's u and v
  /// Whether the rho of features counts, as in the paper. It is made of q'_i and of the same u and
  /// v: with priors on the q'_i, which determine the focal lengths, it says nothing more.
  bool rho = true;
  Loss features_loss;  ///< on |(u, v, rho)| of a feature
  Loss centers_loss;   ///< on |(u, v)| of a centre
  /// Names of shared parameters (`shared_names`) that keep their value. By default the camera is
  /// the paper's, with the exit pupil in the lens, a flat field and one pitch of the array; and the
  /// board is known.
  std::set<std::string> fixed = {"kappa",    "kappa_m", "e_x",   "e_y",   "e_z",
                                 "dC_ratio", "sag_x",   "sag_y", "twist", "aspect"};
  /// Indices of poses that keep their value.
  std::vector<int> fixed_poses;
  std::vector<Prior> priors;
  /// w: how many times larger the variance of what the observations say is than their sigma claims,
  /// see `Uncertainty::dispersion`. It keeps observations and priors in proportion.
  double prior_weight = 1.0;

  /// Adds names to `fixed`.
  PLENOCAL_API void fix(const std::vector<std::string>& names);
  /// Takes names out of `fixed`. Throws std::invalid_argument for one that is not in it.
  PLENOCAL_API void free(const std::vector<std::string>& names);
};

/// Options of the minimisation. The tolerances are those of Ceres; the defaults are at the limit of
/// floating-point precision rather than of practical use, since the cost has a long flat valley.
struct SolverOptions {
  int max_iterations = 200;
  double function_tolerance = 1e-13;
  double gradient_tolerance = 1e-11;
  double parameter_tolerance = 1e-12;
  double initial_trust_region_radius = 1e10;
  int threads = 1;
  /// Whether to jump to the extrapolated limit of the steps when they converge slowly; if false,
  /// Ceres does all the work.
  bool extrapolate = true;
};

/// One iteration, for progress and convergence plots.
struct Iteration {
  int number;
  double cost;  ///< of the last accepted step
  double gradient_max_norm;
  double step_norm;  ///< 2-norm of the change of all parameters; 0 for a rejected step
  double trust_region_radius;
  double time_s;  ///< since the start of the solve
};

/// Called after every iteration; returning false stops the solve.
using Progress = std::function<bool(const Iteration&)>;

/// Why the solver stopped. `kConverged` is Ceres' word alone: the cost, the gradient or the
/// parameters changed by less than a tolerance, which in a long valley can be far from the minimum.
/// Whether it is one is what `Uncertainty::expected_decrease` says: plenocal's own program demands
/// less than 1e-11 of the cost.
enum class Termination { kConverged, kIterationLimit, kStopped, kFailed };

/// The refined camera, board and poses, and a record of the solve.
struct Refinement {
  Camera camera;
  BoardShape<double> board_shape{};
  std::vector<Pose> poses;
  double initial_cost = 0.0;
  double cost = 0.0;
  /// The contribution of the features of each frame to `cost`; the rest is that of the centres.
  std::vector<double> frame_costs;
  Termination termination = Termination::kFailed;
  std::string message;  ///< the reason as stated by Ceres
  std::string report;   ///< Ceres' full report, of the problem with few rows
  double time_s = 0.0;  ///< wall time of the solve
  std::vector<Iteration> iterations;
};

/// Minimises the cost over the free parameters of camera and board and the free poses in one
/// problem.
/// With `max_iterations` = 0 nothing moves, and the result is the cost at the start.
/// Throws std::invalid_argument on input for which the model is not defined. Every frame needs a
/// feature, every board point has to be beyond the focal length initially, and a board whose shape
/// is free needs a size.
PLENOCAL_API Refinement refine(const Camera& camera, const std::vector<Pose>& poses,
                               const Observations& observations, const CostOptions& cost_options,
                               const SolverOptions& solver_options, const Progress& progress = {});

/// How well observations and priors determine the parameters, at a minimum of the cost.
///
/// Parameters: those that all frames share and that are free, in the order of `shared_names`, then
/// 6 per pose (`names`). The former are called intrinsics here, that of the board's shape included.
/// A pose that is fixed has variance 0. A rotation is an axis times an angle, and its covariance
/// that of these three numbers as they are added to: r + dr, not exp(dr) exp(r).
///
/// Every covariance here is A^+ S A^+, with S the covariance of the gradient and A the Hessian of
/// the cost. The two kinds differ in both. H = J'J is the information of the standardised
/// residuals.
///
/// *Independent errors.* A = H, and S = sum_k s_k^2 H_k over the kinds of residuals (features' u
/// and v; features' rho; centres), with the variance s_k^2 of each kind measured as
/// |r_k|^2 / (n_k - tr(H_k H^+)), so that it is valid whether or not the weights match the noise.
/// (All rho of a corner come from one virtual depth; they count as one.)
///
/// *Shared errors.* Residuals of a frame, or of neighbouring centres, may have errors in common. S
/// is then the sum of g g' over frames, over patches of the image (for the centres), and, in the
/// part of a pose that is its own, over the corners of the frame, g being the gradient of the
/// group; each corrected for what the fit takes away from it (`gradient_spread` in
/// src/shared_errors.hpp). A is H except in the weakest directions of the intrinsics: there it is
/// the true Hessian, with the second derivatives that J'J leaves out (src/curvature.hpp). Variances
/// of the intrinsics are at least what S of independent errors makes them with this A: where a few
/// frames scatter less than noise does, that is chance.
///
/// Both contain w^2 H_a of the priors, with H_a their information at w = 1, and the errors of rho
/// that all features of a lens type share.
struct Uncertainty {
  static constexpr int kWeakest = 3;       ///< the largest number of rows in `weakest`
  static constexpr int kEnoughFrames = 6;  ///< so many show what the errors of a frame share
  std::vector<int> free_intrinsics;        ///< indices into `shared_names`
  /// Of all parameters: "F", "kappa", ..., then of each pose "pose 0 r_x" to "pose 0 t_z".
  std::vector<std::string> names;
  int size = 0;  ///< number of parameters
  int rank = 0;  ///< number of independent directions that are determined
  /// Whether `covariance` is that of shared errors: with enough frames, or no free intrinsics.
  bool shared = false;
  Matrix covariance;              ///< size x size
  Matrix independent_covariance;  ///< of independent errors, likewise
  /// If errors are shared: for each free intrinsic, the degrees of freedom of its variance. The
  /// variance is known to a fraction of sqrt(2 / freedom), its root to half of that.
  std::vector<double> freedom;
  /// By how much the free intrinsics would change if a frame were left out, to first order: a row
  /// for each frame; not a number where they would not all be determined any more.
  Matrix left_out_changes;
  /// The share of each frame in what the weights claim the variance of the free intrinsics to be: a
  /// row for each frame, 0 to 1.
  Matrix frame_shares;
  /// How the poses follow the free intrinsics: 6 rows for each frame.
  Matrix poses_by_intrinsics;
  /// How many times larger than the weights claim the variance is that observations leave to the
  /// quantities with a prior, in the mean; 1 without priors. `CostOptions::prior_weight` should be
  /// this. With too few frames it is ten times what independent errors make it.
  double dispersion = 1.0;
  /// By how many standard deviations boards and centres contradict each other at most, if errors
  /// are shared, and the row of the free intrinsic that this moves most; -1 if they agree within
  /// three. No covariance contains it.
  double contradiction = 0.0;
  int contradicted = -1;
  std::vector<double> information;  ///< diagonal of H
  /// The directions of parameter space with the least information in proportion to that on each
  /// parameter alone, the weakest first: a row of `size` changes for each, along one standard
  /// deviation, or, if a direction is not determined (the first size - rank of all), along the unit
  /// of the scaled space.
  Matrix weakest;
  /// Whether the observations determine a parameter at all; if not, its variance is meaningless.
  std::vector<bool> determined;
  /// Measured standard deviation of features' u and v, rho, centres' u and v, px: root of the sum
  /// of squared residuals over their redundancy; not a number for a kind without any. With
  /// a robust loss it is that of the weighted residuals, smaller than the noise.
  std::array<double, 3> residual_std_dev{};
  /// s_k: by how much the errors are larger than their sigma in the cost says; 1 if it is right.
  std::array<double, 3> std_dev_factors{};
  /// Change of the free intrinsics by each systematic error: a row for each error.
  Matrix systematic_changes;
  /// How much a further Gauss-Newton step would lower the cost: 0 at a true minimum.
  double expected_decrease = 0.0;
  /// That step: a change of each parameter.
  std::vector<double> next_step;
  /// The gradient of the cost by each parameter.
  std::vector<double> gradient;

  /// Covariance of two parameters by their names, those of poses included. Throws
  /// std::invalid_argument for a name that is not among `names`.
  PLENOCAL_API double covariance_of(const std::string& a, const std::string& b) const;
  /// sigma of a parameter by its name; throws likewise.
  PLENOCAL_API double std_dev_of(const std::string& name) const;
};

/// An error that observations have in common, such as that of q' from white images: one standard
/// deviation of it.
struct SystematicError {
  std::vector<Feature<double>> features;  ///< by how much each feature moves, px
  std::vector<Pixel<double>> centers;     ///< by how much each centre moves, px; empty for none
  /// By how much the value of each prior moves, in its sigma; empty for none.
  std::vector<double> priors;
  bool in_priors = true;  ///< whether the sigma of the priors contains it already
};

/// The result does not depend on the number of threads. Throws std::invalid_argument like `refine`,
/// and if systematic errors are not of these observations.
PLENOCAL_API Uncertainty uncertainty(const Camera& camera, const std::vector<Pose>& poses,
                                     const Observations& observations,
                                     const CostOptions& cost_options,
                                     const std::vector<SystematicError>& systematic = {},
                                     int threads = 1);

/// The information of each frame on the free intrinsics, with its pose unknown: a square matrix for
/// each frame, the same for any number of threads. Priors and centres take no part. Throws like
/// `refine`.
PLENOCAL_API std::vector<Matrix> frame_information(const Camera& camera,
                                                   const std::vector<Pose>& poses,
                                                   const Observations& observations,
                                                   const CostOptions& cost_options,
                                                   int threads = 1);

}  // namespace plenocal
