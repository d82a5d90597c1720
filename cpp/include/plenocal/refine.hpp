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

/// BAP feature of a board point, observed in a frame through micro-lens (k, l). rho and its
/// standard deviation are not used for a pinhole array.
struct FeatureObservation {
  int frame = 0;                  ///< index into the poses
  Vector3<double> board_point{};  ///< mm, of the flat grid, board frame
  int k = 0, l = 0;
  Feature<double> observed{};              ///< px
  Feature<double> std_dev{1.0, 1.0, 1.0};  ///< px, times the factors of `CostOptions`
};

/// Observed micro-image centre.
struct CenterObservation {
  int k = 0, l = 0;
  Pixel<double> observed{};  ///< px
  double std_dev = 1.0;      ///< px, of u and of v, times the factor of `CostOptions`
};

/// All observations.
struct Observations {
  std::vector<FeatureObservation> features;
  std::vector<CenterObservation> centers;
  /// Board that the features show. Its shape is the initial or the fixed one.
  Board board{};
};

/// Name of |m|, mm (`micro_image_slope`), among the quantities of priors.
constexpr char kSlopeName[] = "m";

/// Returns the name of q'_i, mm (`blur_intercept`), among the quantities of priors: "q'_1" for lens
/// type 0.
inline std::string intercept_name(int lens_type) { return "q'_" + std::to_string(lens_type + 1); }

/// Names of the tilt gradient of the array along u and v, 1/mm (`tilt_gradient`), among the
/// quantities of priors.
constexpr std::array<const char*, 2> kTiltGradientNames = {"tilt_u", "tilt_v"};

/// Independent knowledge of a quantity of the camera: one more residual,
/// (quantity - value) / std_dev.
struct Prior {
  /// Name of a free parameter, see `shared_names`, `kSlopeName`, an `intercept_name` or one of
  /// `kTiltGradientNames`.
  std::string quantity;
  double value;    ///< in the unit of the quantity
  double std_dev;  ///< in the same unit
};

/// Cost function: 1/2 sum rho(|r / sigma|^2) over all observations + w/2 sum r_a^2 over the priors.
/// The sigma of a residual is the sigma of its observation (1 px unless given) times the factor for
/// its kind.
struct CostOptions {
  double uv_std_dev = 1.0;       ///< factor on sigma of a feature's u and v
  double rho_std_dev = 1.0;      ///< factor on sigma of a feature's rho
  double centers_std_dev = 1.0;  ///< factor on sigma of a centre's u and v
  /// True if the cost includes the rho of features, as in the paper. rho is computed from q'_i and
  /// from the same u and v: with priors on the q'_i, which determine the focal lengths, it adds no
  /// information.
  bool rho = true;
  Loss features_loss;  ///< acts on |(u, v, rho)| of a feature
  Loss centers_loss;   ///< acts on |(u, v)| of a centre
  /// Names of shared parameters (`shared_names`) that are fixed. By default the camera is the
  /// paper's, with the exit pupil in the lens, constant distortion, a flat field and one pitch of
  /// the array, and the board is known.
  std::set<std::string> fixed = {"Q1_m",  "kappa", "kappa_m", "omega_x", "omega_y",
                                 "e_x",   "e_y",   "e_z",     "e_r",     "dC_ratio",
                                 "sag_x", "sag_y", "twist",   "aspect"};
  /// Indices of poses that are fixed.
  std::vector<int> fixed_poses;
  std::vector<Prior> priors;
  /// Weight w: variance of the estimates from observations over the variance that their sigma
  /// implies, see `Uncertainty::dispersion`. It keeps observations and priors in proportion.
  double prior_weight = 1.0;

  /// Adds names to `fixed`.
  PLENOCAL_API void fix(const std::vector<std::string>& names);
  /// Removes names from `fixed`. Throws std::invalid_argument for one that is not in it.
  PLENOCAL_API void free(const std::vector<std::string>& names);
};

/// Options of the minimisation. The tolerances are passed to Ceres; the defaults are at the limit
/// of floating-point precision rather than of practical use, since the cost has a long flat valley.
struct SolverOptions {
  int max_iterations = 200;
  double function_tolerance = 1e-13;
  double gradient_tolerance = 1e-11;
  double parameter_tolerance = 1e-12;
  double initial_trust_region_radius = 1e10;
  int threads = 1;
  /// True if the solver jumps to the extrapolated limit of the steps when they converge slowly; if
  /// false, Ceres does all the work.
  bool extrapolate = true;
};

/// One iteration, for progress and convergence plots.
struct Iteration {
  int number;
  double cost;  ///< cost of the last accepted step
  double gradient_max_norm;
  double step_norm;  ///< 2-norm of the change of all parameters; 0 for a rejected step
  double trust_region_radius;
  double time_s;  ///< wall time since the start of the solve
};

/// Function called after every iteration; if it returns false, the solve stops.
using Progress = std::function<bool(const Iteration&)>;

/// Reason why the solver stopped. `kConverged` is the criterion of Ceres alone: the cost, the
/// gradient or the parameters changed by less than a tolerance, which in a long valley can be far
/// from the minimum. `Uncertainty::expected_decrease` shows whether it is a minimum: plenocal's own
/// program demands less than 1e-11 of the cost.
enum class Termination { kConverged, kIterationLimit, kStopped, kFailed };

/// Refined camera, board and poses, and a record of the solve.
struct Refinement {
  Camera camera;
  BoardShape<double> board_shape{};
  std::vector<Pose> poses;
  double initial_cost = 0.0;
  double cost = 0.0;
  /// Contribution of the features of each frame to `cost`; the rest is due to the centres and
  /// priors.
  std::vector<double> frame_costs;
  Termination termination = Termination::kFailed;
  std::string message;  ///< reason as stated by Ceres
  std::string report;   ///< Ceres' full report, of the problem with few rows
  double time_s = 0.0;  ///< wall time of the solve
  std::vector<Iteration> iterations;
};

/// Minimises the cost over the free parameters of camera and board and the free poses in one
/// problem. With `max_iterations` = 0 nothing moves, and the result is the cost at the start.
/// Throws std::invalid_argument on input for which the model is not defined. Every frame needs a
/// feature, every board point has to be beyond the focal length initially, and a board whose shape
/// is free needs a size.
PLENOCAL_API Refinement refine(const Camera& camera, const std::vector<Pose>& poses,
                               const Observations& observations, const CostOptions& cost_options,
                               const SolverOptions& solver_options, const Progress& progress = {});

/// Uncertainty of the parameters from observations and priors, at a minimum of the cost.
///
/// The parameters are the free ones that all frames share, in the order of `shared_names`, then 6
/// per pose (`names`). The former are called intrinsics here, including the shape of the board. A
/// fixed pose has variance 0. A rotation is an axis times an angle, and its covariance refers to
/// additive changes of these three numbers: r + dr, not exp(dr) exp(r).
///
/// Every covariance here is A^+ S A^+, where S is the covariance of the gradient and A the Hessian
/// of the cost. Both differ between the two kinds below. H = J'J is the information of the
/// standardised residuals.
///
/// *Independent errors.* A = H, and S = sum_k s_k^2 H_k over the kinds of residuals (features' u
/// and v; features' rho; centres). The variance s_k^2 of each kind is measured as
/// |r_k|^2 / (n_k - tr(H_k H^+)), so that the result is valid even if the weights do not match the
/// noise. (All rho of a corner come from one virtual depth; they count as one.)
///
/// *Shared errors.* Residuals of a frame, or of neighbouring centres, may share errors. S is then
/// the sum of g g' over frames, over patches of the image (for the centres) and, for the part of a
/// pose that does not follow the intrinsics, over the corners of the frame, where g is the gradient
/// of the group. Each g is corrected for its reduction by the fit (`gradient_spread` in
/// src/shared_errors.hpp). A is H except in the weakest directions of the intrinsics, where it is
/// the true Hessian, with the second derivatives that J'J omits (src/curvature.hpp). Variances of
/// the intrinsics are at least the variances from S of independent errors with this A: if a few
/// frames scatter less than noise does, this is chance.
///
/// Both contain w^2 H_a of the priors, with H_a their information at w = 1, and the errors of rho
/// that all features of a lens type share.
struct Uncertainty {
  static constexpr int kWeakest = 3;       ///< largest number of rows in `weakest`
  static constexpr int kEnoughFrames = 6;  ///< least number of frames for shared errors
  std::vector<int> free_intrinsics;        ///< indices into `shared_names`
  /// Names of all parameters: "F", "kappa", ..., then for each pose "pose 0 r_x" to "pose 0 t_z".
  std::vector<std::string> names;
  int size = 0;  ///< number of parameters
  int rank = 0;  ///< number of independent directions that are determined
  /// True if `covariance` is for shared errors: with enough frames, or no free intrinsics.
  bool shared = false;
  Matrix covariance;              ///< size x size
  Matrix independent_covariance;  ///< for independent errors, of the same size
  /// Part of `covariance` of the free intrinsics due to the independent errors of observations.
  Matrix noise_covariance;
  /// Part of `covariance` of the free intrinsics due to the priors, without the systematic errors
  /// that their sigma contains.
  Matrix prior_covariance;
  /// Degrees of freedom of the variance of each free intrinsic, for shared errors. The relative
  /// uncertainty of the variance is sqrt(2 / freedom), of its root half as much.
  std::vector<double> freedom;
  /// Change of the free intrinsics if a frame were left out, to first order: a row for each frame;
  /// NaN if the others would not determine all of them.
  Matrix left_out_changes;
  /// Share of each frame in the variance of the free intrinsics according to the weights: a row for
  /// each frame, 0 to 1.
  Matrix frame_shares;
  /// Derivative of the poses by the free intrinsics: 6 rows for each frame.
  Matrix poses_by_intrinsics;
  /// Ratio of the variance of the quantities with a prior, as far as observations cause it, to the
  /// variance according to the weights, in the mean; 1 without priors. `CostOptions::prior_weight`
  /// should be equal to it. With too few frames it is ten times the value for independent errors.
  double dispersion = 1.0;
  /// Largest contradiction between boards and centres, in standard deviations, for shared errors,
  /// and the row of the free intrinsic that it affects most; -1 if they agree within three. No
  /// covariance contains it.
  double contradiction = 0.0;
  int contradicted = -1;
  std::vector<double> information;  ///< diagonal of H
  /// Directions of parameter space with the least information relative to the information on each
  /// parameter alone, the weakest first. Each row has `size` changes along one standard deviation
  /// or, if a direction is not determined (the first size - rank of all), along the unit of the
  /// scaled space.
  Matrix weakest;
  /// True for each parameter that the observations determine at all; otherwise its variance is
  /// meaningless.
  std::vector<bool> determined;
  /// Measured standard deviation of features' u and v, rho, centres' u and v, px: root of the sum
  /// of squared residuals over their redundancy; NaN for a kind without any. With a robust loss it
  /// is the standard deviation of the weighted residuals, smaller than the noise.
  std::array<double, 3> residual_std_dev{};
  /// s_k: ratio of the errors to their sigma in the cost; 1 if sigma is right.
  std::array<double, 3> std_dev_factors{};
  /// Change of the free intrinsics by each systematic error: a row for each error.
  Matrix systematic_changes;
  /// Decrease of the cost by a further Gauss-Newton step: 0 at a true minimum.
  double expected_decrease = 0.0;
  /// Change of each parameter in that step.
  std::vector<double> next_step;
  /// Gradient of the cost by each parameter.
  std::vector<double> gradient;

  /// Returns the covariance of two parameters by their names, including poses. Throws
  /// std::invalid_argument for a name that is not among `names`.
  PLENOCAL_API double covariance_of(const std::string& a, const std::string& b) const;
  /// Returns sigma of a parameter by its name; throws like `covariance_of`.
  PLENOCAL_API double std_dev_of(const std::string& name) const;
};

/// Error shared by observations, such as the error of q' from white images: one standard deviation
/// of it.
struct SystematicError {
  std::vector<Feature<double>> features;  ///< change of each feature, px
  std::vector<Pixel<double>> centers;     ///< change of each centre, px; empty for none
  /// Change of the value of each prior, in its sigma; empty for none.
  std::vector<double> priors;
  bool in_priors = true;  ///< true if the sigma of the priors already contains it
};

/// Computes the uncertainty; it does not depend on the number of threads. Throws
/// std::invalid_argument like `refine`, and if systematic errors do not fit these observations.
PLENOCAL_API Uncertainty uncertainty(const Camera& camera, const std::vector<Pose>& poses,
                                     const Observations& observations,
                                     const CostOptions& cost_options,
                                     const std::vector<SystematicError>& systematic = {},
                                     int threads = 1);

/// Computes the information of each frame on the free intrinsics, with its pose unknown: a square
/// matrix for each frame, the same for any number of threads. It excludes priors and centres.
/// Throws like `refine`.
PLENOCAL_API std::vector<Matrix> frame_information(const Camera& camera,
                                                   const std::vector<Pose>& poses,
                                                   const Observations& observations,
                                                   const CostOptions& cost_options,
                                                   int threads = 1);

}  // namespace plenocal
